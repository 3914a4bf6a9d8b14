"""A database that is paused for ten minutes while vehicles go on: what the worker holds, what is lost.

python -m studies.fleet_pause
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil

from studies.fleet_ingest import BROKER_LINES, wait_until_listening
from demo.fleet.servers import PostgresServer, mosquitto
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_backend.queries import result_count

EDGES = 4
RATE_PER_S = 10.0
BEFORE_S = 10.0
CALM_S = 900.0  # a busy machine takes long
MIB = 2**20


@contextmanager
def paused(pid: int) -> Iterator[None]:
    """Stop a server and all of its processes for as long as the block lasts, as a frozen host would."""
    processes = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
    for process in processes:
        process.suspend()
    try:
        yield
    finally:
        for process in processes:
            process.resume()


def start(stack: ExitStack, *words: str) -> "subprocess.Popen[str]":
    """Start a module as a program that does not outlive the stack."""
    child = subprocess.Popen([sys.executable, "-m", *words], stderr=subprocess.PIPE, text=True)
    stack.callback(child.communicate)
    stack.callback(child.kill)
    return child


def measure(pause_s: float) -> bool:
    """Pause, go on, wait for calm; return whether nothing is lost."""
    per_edge = int(RATE_PER_S * (BEFORE_S + pause_s))
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        server = PostgresServer()
        stack.callback(server.close)
        server.start()
        database = server.create("fleet")
        engine = open_database(database)
        stack.callback(engine.dispose)
        migrate(engine)
        port = stack.enter_context(mosquitto(folder, BROKER_LINES))
        worker = start(stack, "fleet_backend", "ingest", "--broker", f"mqtt://127.0.0.1:{port}", "--database", database)
        wait_until_listening(worker)
        words = ("--broker", str(port), "--results", str(per_edge), "--rate", str(RATE_PER_S))
        names = [f"edge{number}" for number in range(EDGES)]
        edges = [
            start(
                stack, "tests.support.chaos.edge", "--store", str(folder / f"{name}.sqlite"), "--vehicle", name, *words
            )
            for name in names
        ]
        time.sleep(BEFORE_S)
        memory = psutil.Process(worker.pid).memory_info
        before, highest = memory().rss, 0
        with paused(server.pid):
            end_s = time.monotonic() + pause_s
            while time.monotonic() < end_s:
                highest = max(highest, memory().rss)
                time.sleep(1.0)
        resumed_s = time.monotonic()
        for edge in edges:
            edge.wait(CALM_S)
        calm_s = time.monotonic() - resumed_s
        made, stored = EDGES * per_edge, result_count(engine)
    print(
        f"database paused {pause_s:g} s: {made:,} results made, {stored:,} stored, {made - stored:,} lost,"
        f" outboxes empty {calm_s:.0f} s after; worker grown by {(highest - before) / MIB:.1f} MiB at most"
    )
    return stored == made


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="of the pause")
    return 0 if measure(parser.parse_args().seconds) else 1


if __name__ == "__main__":
    sys.exit(main())
