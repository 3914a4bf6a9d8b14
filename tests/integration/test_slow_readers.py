"""Readers who ask and do not read: they are few at a time, are left alone, and others get their answers."""

import csv
import json
import socket
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import httpx
import pytest

from fleet_backend.database import open_database
from fleet_backend.page.flight import MOST_STREAMS, Flight, NoRoomError, Room
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import fleet_result, row_of
from tests.support.fleet_page import served
from tests.support.patience import HANG_S

VEHICLES = 2_000  # an answer of more than a megabyte: more than the system holds for a connection
READERS = 3 * MOST_STREAMS
LONG = "/api/v1/vehicles?limit=50000"


@pytest.fixture(name="address", scope="module")
def _address(sqlite_template: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    path = tmp_path_factory.mktemp("readers") / "fleet.sqlite"
    path.write_bytes(sqlite_template.read_bytes())
    engine = open_database(f"sqlite:///{path}")
    row = row_of(fleet_result())
    Writer(engine).store(Batch(shifts=[{**row, "vehicle": f"car{number}"} for number in range(VEHICLES)]))
    engine.dispose()
    with served(f"sqlite:///{path}") as address:
        yield address


@pytest.fixture(name="reader")
def _reader(address: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=address, timeout=HANG_S, trust_env=False) as reader:
        yield reader


def asking(address: str, path: str) -> socket.socket:
    """Return a connection over which an address was asked for, and that takes hardly anything."""
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4_096)
    connection.settimeout(HANG_S)
    host, port = address.removeprefix("http://").split(":")
    connection.connect((host, int(port)))
    connection.sendall(f"GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
    return connection


def test_who_does_not_read_is_one_of_few_and_is_left(address: str, reader: httpx.Client) -> None:
    with ExitStack() as stack:
        readers = [stack.enter_context(asking(address, LONG)) for _ in range(READERS)]
        statuses = [connection.recv(12).decode() for connection in readers]
        counts = Counter(statuses)
        assert counts["HTTP/1.1 200"] <= MOST_STREAMS
        assert counts["HTTP/1.1 503"] >= READERS - MOST_STREAMS
        assert reader.get("/?limit=10").status_code == 200  # of others
        assert reader.get("/api/v1/vehicles").json()["vehicle_count"] == VEHICLES
        while reader.get(LONG).status_code != 200:  # as soon as those who do not read have been left
            time.sleep(0.5)
        waiting = [connection for connection, status in zip(readers, statuses, strict=True) if status.endswith("200")]
        assert all(ends_early(connection) for connection in waiting)


def ends_early(connection: socket.socket) -> bool:
    """Return whether an answer breaks off; reads what is left of it."""
    content = b""
    with suppress(ConnectionResetError):
        while piece := connection.recv(1 << 20):
            content += piece
            if content.endswith(b"\r\n0\r\n\r\n"):
                return False
    return True


def test_long_answers_hold_what_short_ones_do(reader: httpx.Client) -> None:
    whole = reader.get(LONG)
    assert whole.headers["transfer-encoding"] == "chunked"
    answer = whole.json()
    assert (len(answer["vehicles"]), answer["matching_count"], answer["next"]) == (VEHICLES, VEHICLES, None)
    parts = [reader.get(f"/api/v1/vehicles?limit=500&offset={offset}").json() for offset in range(0, VEHICLES, 500)]
    assert [now for part in parts for now in part["vehicles"]] == answer["vehicles"]
    assert parts[0].keys() == answer.keys()
    lines = list(csv.DictReader(reader.get("/vehicles.csv?limit=50000").text.splitlines()))
    assert [line["vehicle"] for line in lines] == [now["vehicle"] for now in answer["vehicles"]]
    due = json.loads(reader.get("/api/v1/maintenance?limit=50000").text)
    assert (len(due["clutches"]), due["clutch_count"]) == (VEHICLES, VEHICLES)
    first = reader.get("/api/v1/maintenance?limit=3").json()
    assert first["clutches"] == due["clutches"][:3]


def test_what_is_whole_in_memory_has_room_or_is_refused() -> None:
    flight = Flight(whole=Room(1_000), streamed=Room(1))
    with flight.whole.taken(900), flight.streamed.taken(1):
        for room, amount in ((flight.whole, 101), (flight.streamed, 1)):
            with pytest.raises(NoRoomError), room.taken(amount):
                pass
        with flight.whole.taken(100):
            pass
    with flight.whole.taken(1_000):
        pass
