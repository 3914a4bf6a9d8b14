"""Random and hostile DoIP streams beside a second reading of the standard."""

import random
from dataclasses import dataclass, field

from ecu_emulator.diagnostics.doip.messages import datagram_reply
from tests.support.doip.desk import ENTITY, Desk, activation, framed, messages_in, request
from tests.support.doip.entity_by_the_book import NEVER_REFUSED, Book
from tests.support.doip.tester import Tester, entity

LONGEST_STREAM = 12
VIN = b"WDCTEMUL3TED00047"
KINDS = (0x0000, 0x0001, 0x0002, 0x0003, 0x0004, 0x0005, 0x0007, 0x0008, 0x4001, 0x4003, 0x8001, 0x8002, 0xF000)


@dataclass
class Figures:
    streams: int = 0
    datagrams: int = 0
    answers: int = 0
    requests: int = 0
    closed: int = 0
    disagreements: list[str] = field(default_factory=list)


class Attacker:
    """Makes messages, most of them right but for one thing."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)  # noqa: S311 - the same streams each time
        self.damage = 0.25

    def stream(self) -> bytes:
        self.damage = self.random.choice((0.0, 0.02, 0.3))
        opening = activation() if self.random.random() < 0.8 else b""
        return opening + b"".join(self.message() for _ in range(self.random.randint(1, LONGEST_STREAM)))

    def message(self) -> bytes:
        made = self._made()
        return self._damaged(made) if self.random.random() < self.damage else made

    def _made(self) -> bytes:
        pick = self.random.choice
        match self.random.randrange(7) if self.random.random() < 0.1 + 2 * self.damage else 1:
            case 0:
                return activation(pick((0x0E00, 0x0E00, 0x0E01, 0x0001)), pick((0, 0, 1, 0xE0)), pick((2, 3)))
            case 1 | 2 | 3:
                data = self.random.randbytes(pick((1, 2, 3, 40, 4095, 4096)))
                return request(data, pick((*[0x0E00] * 30, 0x0E01)), pick((0x1011, 0x1011, 0xE400, 0x1012)))
            case 4:
                return framed(pick(KINDS), self.random.randbytes(pick((0, 0, 2, 6, 7, 17))), pick((2, 3, 3, 0xFF)))
            case 5:
                return framed(8, "0e00")
            case _:
                return self.random.randbytes(self.random.randrange(20))

    def _damaged(self, data: bytes) -> bytes:
        place = self.random.randrange(max(1, min(len(data), 12)))
        match self.random.randrange(3):
            case 0:
                return data[:place] + self.random.randbytes(1) + data[place + 1 :]
            case 1:
                return data[:place]
            case _:
                return data[:place] + self.random.randbytes(1) + data[place:]

    def pieces(self, data: bytes) -> list[bytes]:
        """Cut a stream as a network may."""
        places = sorted(self.random.randrange(len(data) + 1) for _ in range(self.random.randrange(4)))
        return [data[start:stop] for start, stop in zip([0, *places], [*places, len(data)], strict=True)]


def compare_stream(stream: bytes, pieces: list[bytes], figures: Figures) -> None:
    """Tell one connection a stream; note where its answers are not those of the book."""
    desk = Desk()
    desk.open(1)
    told = list(messages_in(bytes.fromhex(desk.put(1, *pieces))))
    book = Book()
    book.read(stream)
    expected = book.told
    figures.streams += 1
    figures.answers += len(told)
    figures.requests += len(desk.asked)
    figures.closed += bool(desk.closed)
    ours = [(kind, payload[: len(wanted[1])]) for (kind, payload), wanted in zip(told, expected, strict=False)]
    is_same = ours == expected and len(told) == len(expected) and len(desk.asked) == book.requests
    if not is_same or bool(desk.closed) is not book.is_over:
        figures.disagreements.append(f"{stream.hex()[:400]}: {told} instead of {expected}")


def compare_datagram(data: bytes, figures: Figures) -> None:
    """Send one datagram; note if it is not answered and must be, or is and must not."""
    reply = datagram_reply(ENTITY, VIN, 0, data)
    figures.datagrams += 1
    figures.answers += reply is not None
    kind = _wanted(data)
    told = None if reply is None else next(iter(messages_in(reply.data)))
    if (None if told is None else (told[0], told[1][:1] if told[0] == 0 else b"")) != kind:
        figures.disagreements.append(f"datagram {data.hex()}: {told} instead of {kind}")


def _wanted(data: bytes) -> tuple[int, bytes] | None:
    """Return type of the answer, and the code if it is a refusal; the lengths are those of the standard's tables."""
    kind, length, body = int.from_bytes(data[2:4], "big"), int.from_bytes(data[4:8], "big"), data[8:]
    asks = {0x0001: b"", 0x0002: bytes.fromhex("020000001011"), 0x0003: VIN}
    versions = (2, 3, 255) if kind in asks else (2, 3)
    if len(data) < 8 or data[0] not in versions or data[0] + data[1] != 255:
        return 0, b"\x00"
    if kind in NEVER_REFUSED:
        return None
    if kind not in (*asks, 0x4001, 0x4003):
        return 0, b"\x01"
    is_right = length == len(asks.get(kind, b"")) == len(body)
    if not is_right:
        return 0, b"\x02" if length > 65536 else b"\x04"
    is_asked = kind in asks
    return None if is_asked and body != asks[kind] else (4 if is_asked else kind + 1, b"")


def run(*, count: int, seed: int) -> Figures:
    """Try so many streams and ten times as many datagrams."""
    figures, attacker = Figures(), Attacker(seed)
    for _ in range(count):
        stream = attacker.stream()
        compare_stream(stream, attacker.pieces(stream), figures)
        for _ in range(10):
            compare_datagram(attacker.message()[:64], figures)
    return figures


def run_on_sockets(*, count: int, seed: int) -> int:
    """Send so many streams, each on a connection of its own that breaks off; return how often a tester was answered."""
    attacker, answered = Attacker(seed), 0
    with entity(alive_check_s=30.0) as (_, server), Tester(server.place.port, 0x0E80) as tester:
        for _ in range(count):
            with Tester(server.place.port, is_activated=False) as hostile:
                try:
                    for piece in attacker.pieces(attacker.stream()):
                        hostile.send(piece)
                except ConnectionError:
                    pass  # the entity has hung up on it
                answered += tester.ask("22 f1 90").startswith("62 f1 90")
    return answered
