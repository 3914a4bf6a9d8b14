"""The adapter's TCP port with clients that are slow, hasty, rude, or many; no bus is needed."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import can
import pytest

from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.elm327.server import ElmServer
from ecu_emulator.diagnostics.table_file import parse_table, shipped_table
from tests.support.patience import HANG_S
from tests.support.uds.full_table import full_text
from tests.unit.ecu_emulator.diagnostics.bench import PARKED

KEY = b"27 02 FB 04 62 9D"  # for a seed of A1 in every byte
SUPPORTED = b"41 00 98 38 80 13 "


@pytest.fixture(scope="module")
def server() -> Iterator[ElmServer]:
    """Yield one adapter for all tests."""
    with ElmServer(controller(), ("127.0.0.1", 0)) as serving:
        yield serving


def controller(text: str | None = None) -> Controller:
    table = shipped_table() if text is None else parse_table(text, "table")
    return Controller(table, values=lambda: PARKED, clock=lambda: 100.0, chance=lambda size: b"\xa1" * size)


@contextmanager
def client(server: ElmServer) -> Iterator[socket.socket]:
    with socket.create_connection(server.address, timeout=HANG_S) as connection:
        yield connection


def until(connection: socket.socket, end: bytes = b">") -> bytes:
    heard = b""
    while not heard.endswith(end):
        piece = connection.recv(4096)
        if not piece:
            return heard
        heard += piece
    return heard


def say(connection: socket.socket, text: bytes) -> bytes:
    connection.sendall(text + b"\r")
    return until(connection)


def test_a_line_may_come_in_pieces_and_several_at_once(server: ElmServer) -> None:
    with client(server) as one:
        say(one, b"ATE0")
        for byte in b"ATSP":
            one.sendall(bytes([byte]))
        assert say(one, b"6") == b"OK\r\r>"
        one.sendall(b"0100\rATI\r010C\r")
        assert until(one, b"AF \r\r>").split(b"\r\r>") == [SUPPORTED, b"ELM327 v1.5", b"41 0C 0C AF ", b""]


def frames(server: ElmServer, is_over: Callable[[], bool]) -> None:
    while not is_over():
        server.hear_frame(can.Message(arbitration_id=0x123, data=b"\1\2\3", is_extended_id=False))


def test_frames_are_shown_until_the_client_says_anything(server: ElmServer) -> None:
    is_over = threading.Event()
    with client(server) as one:
        for command in (b"ATE0", b"ATH1", b"ATCAF0"):
            say(one, command)
        one.sendall(b"ATMA\r")
        sender = threading.Thread(target=lambda: frames(server, lambda: is_over.wait(0.001)))
        sender.start()
        try:
            assert until(one, b"\r").startswith(b"123 01 02 03 \r")
            one.sendall(b"X")  # it ends what is shown and means nothing else
            assert until(one).endswith(b"STOPPED\r\r>")
        finally:
            is_over.set()
            sender.join()
        assert say(one, b"ATI") == b"ELM327 v1.5\r\r>"


def pending(server: ElmServer, connection: socket.socket) -> None:
    """Start a routine whose response comes later."""
    for command in (b"ATE0", b"ATSP6", b"ATSH7E1", b"1003", b"2701", KEY):
        say(connection, command)
    connection.sendall(b"31 01 03 01 04 04\r")
    assert until(connection, b"\r") == b"7F 31 78 \r"


def test_a_session_and_its_lock_are_of_the_client_who_entered_it(later: tuple[ElmServer, Controller]) -> None:
    server, controller = later
    with client(server) as other:
        with client(server) as one:
            pending(server, one)
            controller.finish(0x0301)
            until(one)
            for command in (b"ATE0", b"ATSP6", b"ATSH7E1"):
                say(other, command)
            assert say(one, b"22F186") == b"62 F1 86 03 \r\r>"
            assert say(other, b"22F186") == b"62 F1 86 01 \r\r>"
            assert controller.ask(b"\x22\xf1\x86") == b"\x62\xf1\x86\x01"
            assert say(other, b"1003") == b"7F 10 21 \r\r>"
        while say(other, b"1003") == b"7F 10 21 \r\r>":  # the session ends once its connection has
            pass
        assert say(other, b"22F186") == b"62 F1 86 03 \r\r>"


@pytest.fixture
def later() -> Iterator[tuple[ElmServer, Controller]]:
    asked = controller(full_text())
    with ElmServer(asked, ("127.0.0.1", 0)) as serving:
        yield serving, asked
