"""Hostile ISO-TP streams, after each of which a request must be answered."""

import random
from dataclasses import dataclass

from tests.support.uds.wire import ALL_ID, REQUEST_ID, Wire

LONGEST_STREAM = 24
MOST_REPEATS = 60
SILENCE_S = 2.0  # longer than the transport waits for flow control


@dataclass
class Figures:
    streams: int = 0
    frames: int = 0
    unanswered: int = 0
    responses: int = 0
    dropped: int = 0  # requests of a stream that came faster than their answers could be fetched
    repeated: int = 0


class Attacker:
    """Makes frames that are wrong in every way that a frame has."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)  # noqa: S311 - the same streams each time
        self.sequence = 0

    def frame(self) -> bytes:
        kinds = (self._noise, self._first, self._endless, self._next, self._next, self._control, self._unwanted)
        return self.random.choice((*kinds, lambda: bytes([self.random.randrange(16)]) + self.random.randbytes(7)))()

    def _noise(self) -> bytes:
        return self.random.randbytes(self.random.randrange(9))

    def _first(self) -> bytes:
        """Begin a message of any length, also none."""
        length = self.random.choice((0, 1, 7, 8, 20, 100, 4095))
        return bytes([0x10 | length >> 8, length & 0xFF]) + self.random.randbytes(self.random.choice((6, 6, 6, 3)))

    def _endless(self) -> bytes:
        return b"\x10\x00" + self.random.choice((0, 4095, 4096, 2**32 - 1)).to_bytes(4, "big") + b"\x22\xf1"

    def _next(self) -> bytes:
        """Continue, or continue something else."""
        self.sequence = (self.sequence + self.random.choice((1, 1, 1, 1, 0, 2, -1))) % 16
        return bytes([0x20 | self.sequence]) + self.random.randbytes(self.random.choice((7, 7, 7, 0, 3)))

    def _control(self) -> bytes:
        choice = self.random.choice
        return bytes([0x30 | self.random.randrange(16), choice((0, 1, 255)), choice((0, 1, 0xF1, 0x80, 0xFF))])

    def _unwanted(self) -> bytes:
        """Ask for a long response that nobody will fetch."""
        return self.random.choice((b"\x03\x22\xf1\x90", b"\x02\x19\x0a", b"\x03\x19\x02\xff"))

    def stream(self) -> list[tuple[bytes, int]]:
        count = self.random.randint(1, LONGEST_STREAM)
        return [(self.frame(), self.random.choice((REQUEST_ID, REQUEST_ID, REQUEST_ID, ALL_ID))) for _ in range(count)]


def run(*, count: int, seed: int) -> Figures:
    """Send so many streams; after each, abort what goes out and ask."""
    figures, attacker = Figures(), Attacker(seed)
    with Wire() as wire:
        for _ in range(count):
            stream = attacker.stream()
            for frame, can_id in stream:
                wire.put(frame, can_id)
            figures.streams += 1
            figures.frames += len(stream)
            repeated = _repeated(wire)
            figures.unanswered += repeated is None
            figures.repeated += repeated or 0
            figures.responses = wire.link.counts.responses
            figures.dropped = wire.link.counts.dropped_requests
    return figures


def _repeated(wire: Wire) -> int | None:
    """Ask as a tester does, who repeats what was not answered; return how often that was needed, None if in vain."""
    for repeated in range(MOST_REPEATS):
        wire.put("32 00 00")  # nobody fetches what the stream has asked for
        wire.put("02 10 01")
        while frame := wire.get_within(SILENCE_S):
            if frame.startswith("06 50 01"):
                return repeated
            wire.put("32 00 00")
    return None
