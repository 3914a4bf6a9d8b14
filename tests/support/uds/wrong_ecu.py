"""A controller that shares no code with ours, on a virtual bus, and answers one service wrongly in a way of choice."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import can

REQUEST_ID, RESPONSE_ID = 0x7E1, 0x7E9
Frames = list[bytes]

# What it answers when it does so rightly, by how the request begins; the longest beginning counts.
RIGHT: Mapping[str, str] = {
    "3E00": "7E00",
    "1001": "50010032 01F4",
    "1003": "50030032 01F4",
    "22F197": "62F197 4E4F4E45",
    "220102": "620102 1234",
    "190102": "7F1912",
    "1901": "5901FF 01 0001",
    "1902": "5902FF 081107 2F",
    "1904": "5904 081107 2F 01 01 0102 1234",
    "1906081107FF": "5906 081107 2F 01 05",
    "2701": "6701 12345678",
    "2702": "6702",
    "3101": "71010301 11",
    "3103": "71030301 11",
    "14": "54",
}  # fmt: skip


def right_answer(request: bytes) -> bytes:
    """Return what a controller that works answers."""
    text = request.hex().upper()
    fitting = [start for start in RIGHT if text.startswith(start)]
    if not fitting:
        return bytes([0x7F, request[0], 0x11])
    return bytes.fromhex(RIGHT[max(fitting, key=len)])


def frames_of(message: bytes) -> Frames:
    """Return a message as frames of ISO-TP."""
    if len(message) <= 7:
        return [bytes([len(message)]) + message]
    following = [message[place : place + 7] for place in range(6, len(message), 7)]
    first = bytes([0x10 | len(message) >> 8, len(message) & 0xFF]) + message[:6]
    return [first, *(bytes([0x20 | number & 0x0F]) + piece for number, piece in enumerate(following, 1))]


_IDENTIFIER = {"5904": 4, "5906": 4}  # where an answer names what it is about; others at byte 2


def _flipped(message: bytes, place: int) -> bytes:
    changed = bytearray(message)
    if place < len(changed):
        changed[place] ^= 0x04
    return bytes(changed)


def _cut(message: bytes) -> Frames:
    *before, last = frames_of(message)
    return before or [last[:-1]]


def _wrong_length(message: bytes) -> Frames:
    first, *more = frames_of(message)
    return [bytes([first[0], first[1] + 9]) + first[2:], *more] if more else [bytes([7]) + first[1:-1]]


# Each way takes the request and the right answer and returns the frames that come instead.
WAYS: Mapping[str, Callable[[bytes, bytes], Frames]] = {
    "service alone": lambda _, right: frames_of(right[:1]),
    "a byte short": lambda _, right: frames_of(right[:-1]),
    "head alone": lambda _, right: frames_of(right[:2]),
    "a byte long": lambda _, right: frames_of(right + b"\x2f"),
    "wrong echo": lambda _, right: frames_of(_flipped(right, 1)),
    "other identifier": lambda _, right: frames_of(_flipped(right, _IDENTIFIER.get(right[:2].hex(), 2))),
    "cut": lambda _, right: _cut(right),
    "empty": lambda _request, _right: [b"\x00"],
    "other service": lambda _, right: frames_of(_flipped(right, 0)),
    "negative for another": lambda request, _: frames_of(bytes([0x7F, request[0] ^ 0x04, 0x31])),
    "negative and short": lambda request, _: frames_of(bytes([0x7F, request[0]])),
    "negative and long": lambda request, _: frames_of(bytes([0x7F, request[0], 0x31, 0x00])),
    "negative without reason": lambda request, _: frames_of(bytes([0x7F, request[0], 0x00])),
    "doubled": lambda _, right: frames_of(right + right),
    "wrong length byte": lambda _, right: _wrong_length(right),
    "nothing": lambda _request, _right: [],
    "twice": lambda _, right: [*frames_of(right), *frames_of(right)] if len(right) <= 7 else frames_of(right),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """Which answer is wrong, by how its request begins, and how."""

    request: str
    way: Callable[[bytes, bytes], Frames]


class WrongEcu(can.Listener):
    """Answers on an open bus; keeps what it was asked."""

    def __init__(self, bus: can.BusABC, fault: Fault | None = None) -> None:
        self._bus = bus
        self._fault = fault
        self._waiting: Frames = []
        self.asked: list[str] = []

    def on_message_received(self, msg: can.Message) -> None:
        if msg.arbitration_id != REQUEST_ID:
            return
        kind, data = msg.data[0] >> 4, bytes(msg.data)
        if kind == 3:
            self._send(self._waiting)
            self._waiting = []
        elif kind == 0:
            request = data[1 : 1 + data[0]]
            self.asked.append(request.hex().upper())
            self._answer(request)

    def _answer(self, request: bytes) -> None:
        right = right_answer(request)
        fault = self._fault
        is_wrong = fault is not None and request.hex().upper().startswith(fault.request)
        frames = fault.way(request, right) if fault is not None and is_wrong else frames_of(right)
        if frames and frames[0][0] >> 4 == 1:
            self._waiting = frames[1:]
            frames = frames[:1]
        self._send(frames)

    def _send(self, frames: Sequence[bytes]) -> None:
        for frame in frames:
            self._bus.send(can.Message(arbitration_id=RESPONSE_ID, is_extended_id=False, data=frame))


@contextmanager
def wrong_ecu(channel: str, fault: Fault | None = None) -> Iterator[WrongEcu]:
    """Let it answer on a virtual bus for the time of the block."""
    with can.Bus(channel, "virtual") as bus:
        ecu = WrongEcu(bus, fault)
        with can.Notifier(bus, [ecu], timeout=0.05):
            yield ecu
