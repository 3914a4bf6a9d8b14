"""Random and hostile DoIP streams."""

import random

from tests.support.doip.desk import activation, framed, request
from tests.support.doip.tester import Tester, entity

LONGEST_STREAM = 12
KINDS = (0x0000, 0x0001, 0x0002, 0x0003, 0x0004, 0x0005, 0x0007, 0x0008, 0x4001, 0x4003, 0x8001, 0x8002, 0xF000)


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
