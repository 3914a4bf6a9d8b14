"""Ingest workers for tests: as a process, as a thread of the test, and as ones that are killed at a step of their work.

``python -m tests.support.fleet_worker --broker ... --database ...`` is one worker after the other, each of which ends,
as by a power cut, at another step of its second batch. Forks of one process, which saves the starts of five.
"""

import argparse
import asyncio
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path

from sqlalchemy import Connection, Engine, event

from fleet_backend.choices import Pace
from fleet_backend.config import parse_broker
from fleet_backend.database import open_database
from fleet_backend.ingest import FILTERS, Inbox, Worker, connected
from fleet_backend.writer import Batch, Identity, Writer
from fleet_contract import JsonObject, Outgoing
from fleet_link import Message
from tests.support.patience import HANG_S


class Step(StrEnum):
    """The steps between a message's arrival and its end."""

    BEFORE_INSERT = "before_insert"
    BEFORE_COMMIT = "before_commit"
    AFTER_COMMIT = "after_commit"
    AFTER_RECEIPT = "after_receipt"
    AFTER_PUBACK = "after_puback"


class Doom:
    """Ends this process at one step of its second batch."""

    def __init__(self, step: Step) -> None:
        self.step = step
        self._left = 2

    def at(self, step: Step) -> None:
        """Pass a step, or not."""
        if step is self.step:
            self._left -= 1
            if not self._left:
                os.kill(os.getpid(), signal.SIGKILL)


class DoomedStore:
    """A store that dies before, in or after its transaction."""

    def __init__(self, engine: Engine, doom: Doom) -> None:
        self._writer = Writer(engine)
        self._doom = doom
        event.listen(engine, "commit", self._before_commit)

    def store(self, batch: Batch) -> set[Identity]:
        """Store a batch."""
        self._doom.at(Step.BEFORE_INSERT)
        aside = self._writer.store(batch)
        self._doom.at(Step.AFTER_COMMIT)
        return aside

    def fills(self, vehicles: Sequence[str]) -> dict[str, list[JsonObject]]:
        """Return fluid fills."""
        return self._writer.fills(vehicles)

    def _before_commit(self, _connection: Connection) -> None:
        self._doom.at(Step.BEFORE_COMMIT)


class DoomedInbox:
    """A connection that dies once its words have left for the broker."""

    def __init__(self, inbox: Inbox, doom: Doom) -> None:
        self._inbox = inbox
        self._doom = doom
        self._pending: Step | None = None
        self.takes_bundles = inbox.takes_bundles
        self.unsettled_count = 0

    async def collect(self, limit: int, patience_s: float) -> list[Message]:
        """Return the next messages; what was queued for the broker before is on its way by now."""
        await asyncio.sleep(0.1)
        if self._pending is not None:
            self._doom.at(self._pending)
        return await self._inbox.collect(limit, patience_s)

    def send(self, messages: Sequence[Outgoing]) -> None:
        """Send receipts."""
        self._inbox.send(messages)

    def acknowledge(self, messages: Sequence[Message]) -> None:
        """Settle with the broker, unless the end comes before."""
        if self._doom.step is Step.AFTER_RECEIPT:
            self._pending = Step.AFTER_RECEIPT
            return
        self._inbox.acknowledge(messages)
        self._pending = Step.AFTER_PUBACK


@contextmanager
def worker(folder: Path, broker: str, database: str, *more: str, module: str = "fleet_backend") -> Iterator[int]:
    """Run a worker until the block ends, and yield its process id when it listens."""
    command = [sys.executable, "-m", module, *(["ingest"] if module == "fleet_backend" else [])]
    log = folder / f"worker-{len(list(folder.glob('worker-*')))}.log"
    with log.open("wb") as out:
        child = subprocess.Popen([*command, "--broker", broker, "--database", database, *more], stderr=out)
    try:
        _wait_for(log, "listening", child)
        yield child.pid
    finally:
        child.terminate()
        child.wait(HANG_S)


@contextmanager
def worker_here(broker: str, database: str) -> Iterator[None]:
    """Run a worker in a thread until the block ends, where a process of its own would add nothing."""
    address, engine, pace = parse_broker(broker), open_database(database), Pace()
    one = Worker(
        lambda: connected(address, FILTERS, max_unsettled=pace.max_unsettled),
        Writer(engine),
        name="here",
        now=lambda: datetime.now(UTC),
        pace=pace,
    )
    loop = asyncio.new_event_loop()
    work = loop.create_task(one.run())

    def run() -> None:
        with suppress(asyncio.CancelledError):
            loop.run_until_complete(work)
        loop.run_until_complete(loop.shutdown_default_executor())  # whoever asks the database still has a connection

    thread = threading.Thread(target=run, name="worker")
    thread.start()
    try:
        deadline_s = time.monotonic() + HANG_S
        while not one.is_listening:
            assert time.monotonic() < deadline_s
            time.sleep(0.02)
        yield
    finally:
        loop.call_soon_threadsafe(work.cancel)
        thread.join(HANG_S)
        loop.close()
        engine.dispose()


def _wait_for(log: Path, text: str, child: "subprocess.Popen[bytes]") -> None:
    deadline_s = time.monotonic() + HANG_S
    while text not in log.read_text(encoding="utf-8"):
        assert child.poll() is None, log.read_text(encoding="utf-8")
        assert time.monotonic() < deadline_s, log.read_text(encoding="utf-8")
        time.sleep(0.02)


async def _work(broker: str, engine: Engine, doom: Doom) -> None:
    address = parse_broker(broker)
    pace = Pace(batch_size=20, patience_s=0.05)

    @asynccontextmanager
    async def connect() -> AsyncIterator[DoomedInbox]:
        async with connected(address, FILTERS, max_unsettled=pace.max_unsettled) as inbox:
            sys.stderr.write("listening\n")
            sys.stderr.flush()
            yield DoomedInbox(inbox, doom)

    store = DoomedStore(engine, doom)
    await Worker(connect, store, name="doomed", now=lambda: datetime.now(UTC), pace=pace).run()


def main() -> None:
    """Have workers die, one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--broker", required=True)
    parser.add_argument("--database", required=True)
    options = parser.parse_args()
    for step in Step:
        if child := os.fork():
            status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            if status != -signal.SIGKILL:
                sys.exit(f"{step}: ended with status {status}")
            continue
        try:
            asyncio.run(_work(options.broker, open_database(options.database), Doom(step)))
        finally:
            os._exit(1)


if __name__ == "__main__":
    main()
