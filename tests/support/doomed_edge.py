"""Edges of one store that kill themselves with SIGKILL, each at another step: ``doomed_edge STORE PORT``.

Each stores ``NEW_COUNT`` more live results than the one before and sends what waits; the last one ends when a backend
has acknowledged all. How each ended is printed. Forks of one process, which saves the starts of seven.
"""

import asyncio
import json
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import closing
from enum import StrEnum
from pathlib import Path

from clutch_results.records import ShiftResult
from diag_service.delivery import Acknowledge, MqttConnector, Outbox, mqtt
from diag_service.store import ResultStore, VehicleState, Versions
from fleet_contract import Outgoing, Receipt
from fleet_link import BrokerAddress, Connection
from tests.support.builders import shift_result
from tests.support.patience import HANG_S

NEW_COUNT = 5
STATE = VehicleState(filter_state={}, condition={}, versions=Versions(algorithm="a", calibration="c"))
NOW = "2026-01-01T00:00:00.000000Z"


class Step(StrEnum):
    """Where it dies."""

    BEFORE_INSERT = "before the insert"
    AFTER_INSERT = "after the insert"
    BEFORE_PUBLISH = "before the publish"
    BEFORE_PUBACK = "published, before the broker answers"
    AFTER_PUBACK = "after the broker answered"
    BEFORE_SETTLE = "acknowledged, before it is noted"
    AFTER_SETTLE = "after the acknowledgement is noted"
    NONE = "never"


def die_at(step: Step, here: Step) -> None:
    if step is here:
        os.kill(os.getpid(), signal.SIGKILL)


class DoomedStore(ResultStore):
    """A store whose process dies around a transaction."""

    step = Step.NONE

    def add(self, result: ShiftResult, state: VehicleState | None) -> bool:
        die_at(self.step, Step.BEFORE_INSERT)
        is_new = super().add(result, state)
        die_at(self.step, Step.AFTER_INSERT)
        return is_new

    def note_receipts(self, receipts: Sequence[Receipt]) -> list[int]:
        die_at(self.step, Step.BEFORE_SETTLE)
        positions = super().note_receipts(receipts)
        die_at(self.step, Step.AFTER_SETTLE)
        return positions


class DoomedConnection(Connection):
    """A connection whose process dies around a message of a result."""

    step = Step.NONE

    async def publish_all(self, messages: Sequence[Outgoing]) -> None:
        await super().publish_all(messages)
        if any(message.topic.endswith("/shift") for message in messages):
            die_at(self.step, Step.AFTER_PUBACK)

    def _start(self, message: Outgoing) -> None:
        is_result = message.topic.endswith("/shift")
        if is_result:
            die_at(self.step, Step.BEFORE_PUBLISH)
        super()._start(message)
        if is_result:
            die_at(self.step, Step.BEFORE_PUBACK)


async def send(store: ResultStore, port: int) -> int:
    address = BrokerAddress(host="127.0.0.1", port=port)
    connector = MqttConnector(address, "clutchdiag-car1", is_persistent=True)
    outbox = Outbox(store, "car1", lambda: connector.connect(NOW), str(address), acknowledge=Acknowledge.BACKEND)
    return await outbox.close(asyncio.create_task(outbox.run()), timeout_s=HANG_S)


def edge(path: Path, port: int, last_seq: int, step: Step) -> int:
    DoomedConnection.step = step
    vars(mqtt)["Connection"] = DoomedConnection
    with closing(DoomedStore.open(path)) as store:
        store.step = step
        while (seq := store.next_seq()) <= last_seq:
            store.add(shift_result(seq, stream=store.stream), STATE)
        return asyncio.run(send(store, port))


def end_of(path: Path, port: int, last_seq: int, step: Step) -> int:
    """Return the exit status of an edge, negative if a signal ended it."""
    if child := os.fork():
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    status = 1
    try:
        status = edge(path, port, last_seq, step)
    finally:
        os._exit(status)


def main(path: str, port: str) -> None:
    ends = {step: end_of(Path(path), int(port), NEW_COUNT * number, step) for number, step in enumerate(Step, start=1)}
    print(json.dumps(ends))


if __name__ == "__main__":
    main(*sys.argv[1:])
