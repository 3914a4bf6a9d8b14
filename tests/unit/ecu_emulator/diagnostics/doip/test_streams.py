"""One connection and several, byte by byte as ISO 13400-2 has them; the time is the test's."""

import pytest

from ecu_emulator.diagnostics.doip.streams import MOST_WAITING
from tests.support.doip.desk import Desk, activation, framed, request

ACTIVATED, NO_SOCKET, OTHER_SOURCE, IN_USE = "10", "01", "02", "03"
ALIVE_CHECK = "03fc000700000000"


@pytest.fixture
def desk() -> Desk:
    desk = Desk()
    desk.activate(1)
    return desk


def test_so_many_requests_may_wait(desk: Desk) -> None:
    for _ in range(MOST_WAITING):
        assert desk.put(1, request("3e00"))[24:26] == "00"
    assert desk.put(1, request("3e00"))[24:26] == "05"
    desk.respond(1, b"\x7f\x3e\x78", is_final=False)
    assert desk.put(1, request("3e00"))[24:26] == "05"
    desk.respond(1, b"\x7e\x00")
    assert desk.put(1, request("3e00"))[24:26] == "00"


def test_a_tester_that_is_alive_keeps_its_address(desk: Desk) -> None:
    desk.open(2)
    assert desk.put(2, activation()) == ""  # the other one is asked first
    assert desk.told(1) == ALIVE_CHECK
    desk.wait(0.4)
    desk.put(1, framed(8, "0e00"))
    assert desk.told(2)[24:26] == IN_USE
    assert desk.closed == [2]
    desk.wait(1.0)
    assert desk.put(1, request("3e00"))[24:26] == "00"


@pytest.mark.parametrize("answer", [b"", framed(8, "0e01"), framed(0x8001, "0e0010113e00")])
def test_a_tester_that_does_not_say_that_it_is_alive_makes_room(desk: Desk, answer: bytes) -> None:
    desk.open(2)
    desk.put(2, activation())
    desk.put(1, answer)
    desk.wait(0.49)
    assert desk.told(2) == ""
    desk.wait(0.02)
    assert desk.told(2)[24:26] == ACTIVATED
    assert desk.closed == [1]


def test_all_are_asked_when_there_is_no_room(desk: Desk) -> None:
    for number in (2, 3, 4):
        assert desk.activate(number, 0x0E00 + number)[8:10] == ACTIVATED
    desk.open(5)
    assert desk.put(5, activation(0x0E05)) == ""
    for number in (2, 3, 4):
        desk.put(number, framed(8, f"0e0{number}"))
    assert desk.told(5) == ""  # the first one has not answered
    desk.put(1, framed(8, "0e00"))
    assert desk.told(5)[24:26] == NO_SOCKET
    desk.open(6)
    assert desk.put(6, activation(0x0E06)) == ""
    desk.put(1, framed(8, "0e00"))
    desk.wait(0.5)
    assert desk.told(6)[24:26] == ACTIVATED
    assert sorted(desk.step.sockets) == [1, 6]


def test_a_connection_without_activation_ends_after_two_seconds() -> None:
    desk = Desk()
    desk.open(1)
    desk.wait(1.9)
    desk.put(1, framed(7))  # something else does not help
    desk.wait(0.2)
    assert desk.closed == [1]
