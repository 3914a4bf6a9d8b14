"""Packets in large pieces: how they were cut does not matter, and what is no MQTT ends the connection."""

import logging
from collections import deque

import pytest

from fleet_contract import Outgoing
from fleet_link.bulk import Bulk, BulkTerms

TERMS = BulkTerms(keepalive_s=10.0, max_packet_bytes=300, max_in_flight=2)
LONG = b"\x32\x8d\x02" + b"\x00\x01b\x01\x02\x00" + 263 * b"x"  # a length of two bytes
MESSAGES = b"\x30\x05\x00\x01a\x00p" + LONG + b"\x32\x0c\x00\x01c\x00\x07\x04\x26\x00\x00\x00q!" + b"\xd0\x00"
TAKEN = [("a", b"p", 0), ("b", 263 * b"x", 258), ("c", b"q!", 7)]  # the last with properties


class FakeSocket:
    """Gives pieces, and takes so many bytes."""

    def __init__(self, *pieces: bytes, room: int = 1_000_000) -> None:
        self.pieces = deque(pieces)
        self.room = room
        self.sent = b""

    def recv(self, _count: int, /) -> bytes:
        if not self.pieces:
            raise BlockingIOError
        return self.pieces.popleft()

    def send(self, data: bytearray, /) -> int:
        if not self.room:
            raise BlockingIOError
        count = min(self.room, len(data))
        self.room -= count
        self.sent += data[:count]
        return count


class Clock:
    """Stands still until it is set."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def bulk_on(sock: FakeSocket, clock: Clock | None = None) -> tuple[Bulk, list[tuple[str, bytes, int]]]:
    taken: list[tuple[str, bytes, int]] = []
    return Bulk(sock, TERMS, lambda *message: taken.append(message), clock or Clock()), taken


@pytest.mark.parametrize("size", [1, 2, 3, 7, 271, 1000])
def test_messages_are_the_same_however_they_were_cut(size: int) -> None:
    pieces = [MESSAGES[first : first + size] for first in range(0, len(MESSAGES), size)]
    bulk, taken = bulk_on(FakeSocket(*pieces))
    for _ in pieces:
        bulk.read()
    assert taken == TAKEN


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (b"", ConnectionError),  # the broker hung up
        (b"\x32\xff\xff\xff\xff\x01", ValueError),  # a length of five bytes
        (b"\x32\xad\x02", ValueError),  # longer than we asked for
        (b"\xe0\x00", ValueError),  # it takes leave
        (b"\x30\x05\x00\x01a\x09p", ValueError),  # properties beyond the end
        (b"\x30\x03\x00\x01a", IndexError),  # no properties at all
        (b"\x30\x05\x00\x01\xff\x00p", ValueError),  # a topic that is no text
    ],
)
def test_what_is_no_message_ends_the_connection(data: bytes, error: type[Exception]) -> None:
    bulk, taken = bulk_on(FakeSocket(data))
    with pytest.raises(error):
        bulk.read()
    assert taken == []


def test_acknowledgements_go_in_one_piece_and_wait_for_room() -> None:
    sock = FakeSocket(room=3)
    bulk, _ = bulk_on(sock)
    bulk.acknowledge([1, 258])
    bulk.flush()
    assert (sock.sent, bulk.has_more) == (b"\x40\x02\x00", True)
    sock.room = 100
    bulk.flush()
    assert (sock.sent, bulk.has_more) == (b"\x40\x02\x00\x01\x40\x02\x01\x02", False)


def test_no_more_of_ours_is_in_flight_than_the_broker_wants(caplog: pytest.LogCaptureFixture) -> None:
    sock = FakeSocket()
    bulk, _ = bulk_on(sock)
    bulk.send(Outgoing(topic="t", payload=b"%d" % number, is_retained=number == 1) for number in range(3))
    bulk.flush()
    first = b"\x32\x07\x00\x01t\x00\x01\x000" + b"\x33\x07\x00\x01t\x00\x02\x001"
    assert sock.sent == first
    sock.pieces.append(b"\x40\x04\x00\x01\x87\x00\x40\x02\x00\x09")  # refused; and an answer to nothing
    with caplog.at_level(logging.WARNING):
        bulk.read()
    bulk.flush()
    assert sock.sent == first + b"\x32\x07\x00\x01t\x00\x03\x002"
    assert caplog.messages == ["the broker refused an acknowledgement: reason 135, t"]


def test_it_asks_for_a_sign_of_life_and_gives_up_without_one() -> None:
    sock, clock = FakeSocket(b"\xd0\x00"), Clock()
    bulk, _ = bulk_on(sock, clock)
    for now_s in (1.0, 6.0, 7.0):
        clock.now_s = now_s
        bulk.tick()
    bulk.flush()
    assert sock.sent == b"\xc0\x00"
    bulk.read()
    clock.now_s = 21.0
    bulk.tick()
    clock.now_s = 23.0
    with pytest.raises(ConnectionError, match="says nothing"):
        bulk.tick()
