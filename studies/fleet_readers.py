"""Readers of the fleet's page who ask for all vehicles and never read; `studies.fleet_hostile` plays them."""

import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import httpx
import psutil

from clutch_results.records import shift_record
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_backend.page.server import STALLED_S
from fleet_backend.rows import shift_row
from fleet_backend.writer import Batch, Writer
from studies.builders import shift_result
from studies.fleet_properties import peak_bytes

VEHICLES, READERS = 50_000, 100
ALL_VEHICLES: Final = "/api/v1/vehicles?limit=50000"
_BATCH: Final = 5_000
_START_S: Final = 300.0
_ANSWER_S: Final = 120.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadersOutcome:
    """What came of readers who do not read."""

    before_bytes: int  # of memory of the page, when it had answered everything once
    most_bytes: int
    after_bytes: int  # when all have been left
    answered_count: int  # other readers' pages that were answered while they were there
    asked_count: int
    left_count: int  # of those who do not read


def fill(url: str, count: int) -> None:
    """Store a result of each of many vehicles."""
    engine = open_database(url)
    migrate(engine)
    writer, row = Writer(engine), shift_row(shift_record(shift_result()))
    for first in range(0, count, _BATCH):
        numbers = range(first, min(first + _BATCH, count))
        writer.store(Batch(shifts=[{**row, "vehicle": f"car{number:05d}"} for number in numbers]))
    engine.dispose()


@contextmanager
def page_of(folder: Path, url: str) -> Iterator[tuple[psutil.Process, str]]:
    """Run the page until the block ends, and yield its process and address."""
    command = [sys.executable, "-m", "fleet_backend", "serve", "--listen", "127.0.0.1:0", "--database", url]
    out = folder / "page.txt"
    with out.open("wb") as text:
        child = subprocess.Popen(command, stdout=text, stderr=subprocess.STDOUT)
    try:
        deadline_s = time.monotonic() + _START_S
        while not (told := re.search(r"http://\S+(?=/ )", out.read_text(encoding="utf-8"))):
            if child.poll() is not None or time.monotonic() > deadline_s:
                raise RuntimeError(out.read_text(encoding="utf-8"))
            time.sleep(0.1)
        yield psutil.Process(child.pid), told.group()
    finally:
        child.terminate()
        child.wait(_START_S)


def attack_by_readers(folder: Path, vehicles: int = VEHICLES, readers: int = READERS) -> ReadersOutcome:
    """Ask for all vehicles over many connections without reading, while somebody else looks at pages."""
    url = f"sqlite:///{folder}/readers.sqlite"
    fill(url, vehicles)
    with page_of(folder, url) as (page, address), ExitStack() as stack:
        client = stack.enter_context(httpx.Client(base_url=address, timeout=_ANSWER_S, trust_env=False))
        client.get(ALL_VEHICLES).raise_for_status()
        before_bytes = page.memory_info().rss
        host, port = address.removeprefix("http://").split(":")
        silent = [stack.enter_context(socket.create_connection((host, int(port)))) for _ in range(readers)]
        for connection in silent:
            connection.sendall(f"GET {ALL_VEHICLES} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        statuses, deadline_s = list[int](), time.monotonic() + 3.0 * STALLED_S
        while time.monotonic() < deadline_s:
            with suppress(httpx.TimeoutException):
                statuses.append(client.get("/api/v1/vehicles").status_code)
            time.sleep(0.2)
        there = {connection.raddr.port for connection in page.net_connections() if connection.raddr}
        left_count = sum(connection.getsockname()[1] not in there for connection in silent)
        return ReadersOutcome(
            before_bytes=before_bytes,
            most_bytes=peak_bytes(page.pid),
            after_bytes=page.memory_info().rss,
            answered_count=statuses.count(200),
            asked_count=len(statuses),
            left_count=left_count,
        )
