"""Random clients: some know the protocol, some know it badly, some know nothing."""

from collections.abc import Callable, Sequence
from functools import partial
from random import Random
from typing import Any

from tests.support.uds.pair import Pair

RESULTS = ("failed", "passed", "prefailed", "prepassed")


class RandomClient:
    """Makes requests out of a table and of what it was answered before."""

    def __init__(self, random: Random, document: dict[str, Any], codes: list[int]) -> None:
        self.random = random
        self.data: list[int] = [entry["number"] for entry in document["data"]]
        self.routines: list[int] = [entry["number"] for entry in document["routine"]]
        self.levels = {entry["number"]: entry for entry in document["security"]}
        self.services = [entry["number"] for entry in document["service"]]
        self.stored: dict[int, dict[str, Any]] = {
            entry["number"]: entry for entry in document["data"] if "write" in entry
        }
        self.codes = codes
        self.favourites = random.choice(
            ([], [0x2A, 0x2A, 0x2A, 0x2C, 0x2C], [0x27] * 8, [0x31] * 5, [0x2E, 0x2F, 0x2C, 0x22, 0x22])
        )
        self.seed: tuple[int, bytes] | None = None
        self.skill = random.choice((0.1, 0.6, 0.9))  # how often a key is right
        self.opening = self._opening() if random.random() < 0.7 else []

    def request(self) -> bytes:
        """Return one request: mostly sensible, often damaged, sometimes noise."""
        if self.opening:
            return self.opening.pop(0)() if self.random.random() < 0.95 else b"\x3e\x00"
        kind = self.random.random()
        if kind < 0.07:
            return self.random.randbytes(self.random.randint(1, 12))
        if kind < 0.10:
            return bytes([self.random.randrange(256)])
        request = self.sensible()
        return self.damaged(request) if kind < 0.35 else request

    def _opening(self) -> list[Callable[[], bytes]]:
        """Return how one who knows the way gets in, and what he may be after."""
        if 0x2A in self.favourites:
            definition = bytes.fromhex("2c 01 f2 10 01 03 01 02")
            requests = [b"\x10\x03", definition, b"\x2a\x03\x00\x01\x10", b"\x2a\x02\x02"]
            return [partial(bytes, request) for request in requests]
        level = self.random.choice((1, 1, 3))
        sessions = [b"\x10\x03", b"\x10\x40"] if level == 3 else [b"\x10\x03"]
        asked = [(lambda request=request: request) for request in (*sessions, bytes([0x27, level]))]
        if self.skill < 0.5:
            return [*asked, self._keyed, asked[-1], self._keyed, asked[-1], self._keyed, asked[-1], asked[-1]]
        return [*asked, self._keyed, self.random.choice((lambda: b"\x31\x01\x03\x01\x04\x04", self.sensible))]

    def _keyed(self) -> bytes:
        return b"\x27" + self._key(is_right=self.random.random() < self.skill) if self.seed else b"\x3e\x00"

    def _key(self, *, is_right: bool) -> bytes:
        number, seed = self.seed or (1, bytes(4))
        mask: int = self.levels[number]["key_mask"]
        key = int.from_bytes(seed, "big") ^ mask ^ (not is_right)
        return bytes([number + 1]) + key.to_bytes(len(seed), "big")

    def damaged(self, request: bytes) -> bytes:
        """Return a request with a byte changed, added or missing."""
        place = self.random.randrange(len(request))
        match self.random.randrange(4):
            case 0:
                return request[:place] + self.random.randbytes(1) + request[place + 1 :]
            case 1:
                return request[: max(1, place)]
            case 2:
                return request + self.random.randbytes(self.random.randint(1, 3))
            case _:
                return request[:place] + self.random.randbytes(1) + request[place:]

    def sensible(self) -> bytes:
        """Return a request of any service with parameters that exist, or nearly."""
        service = self.random.choice([*self.services, *self.favourites])
        request = bytes([service]) + self._parameters(service)
        if self.random.random() < 0.12 and len(request) > 1:
            request = bytes([service, request[1] | 0x80]) + request[2:]
        return request

    def _parameters(self, service: int) -> bytes:
        by_service: dict[int, Callable[[], bytes]] = {
            0x10: lambda: self.one_of(b"\1", *[b"\3"] * 8, *[b"\x40"] * 8, b"\2"),
            0x11: lambda: self.one_of(b"\1", b"\2", b"\3", b"\4"),
            0x14: lambda: self.number((0xFFFFFF, *self.codes, 0x123456), 3),
            0x19: self._report,
            0x22: self._names,
            0x27: self._security,
            0x28: lambda: bytes([self.random.randrange(5), self.random.choice((1, 2, 3, 0, 0xF1, 0x11))]),
            0x2A: lambda: self.one_of(b"\1", b"\2", b"\3", b"\3", b"\4", b"\5") + bytes(self._lows()),
            0x2C: self._definition,
            0x2E: self._written,
            0x2F: lambda: self.number((0x0206, 0x0206, *self.data)) + self.one_of(b"\0", b"\1", b"\2", b"\3\x70"),
            0x31: self._routine,
            0x85: lambda: self.one_of(b"\1", b"\2", b"\3", b"\2\xff\xff\xff", b"\1\0\0\0"),
        }
        return by_service.get(service, lambda: b"\0")()

    def one_of(self, *choices: bytes) -> bytes:
        """Return one of several pieces of a request."""
        return self.random.choice(choices)

    def number(self, choices: Sequence[int], size_bytes: int = 2) -> bytes:
        """Return one of several numbers."""
        return self.random.choice(choices).to_bytes(size_bytes, "big")

    def _names(self) -> bytes:
        count = self.random.choice((1, 1, 1, 2, 3, 17))
        return b"".join(self.number((*self.data, 0xF300, 0xF301, 0x1234)) for _ in range(count))

    def _lows(self) -> list[int]:
        """Return lower bytes of data that can be sent periodically, and of some that cannot."""
        count = self.random.choice((0, 1, 1, 2, 4, 12))
        return self.random.choices((0, 1, 2, 3, *range(0x10, 0x1A), 0x77), k=count)

    def _report(self) -> bytes:
        report = self.random.choice((1, 2, 3, 4, 6, 0x0A, 0x14, 0x1A, 5))
        if report == 0x1A:
            return bytes([report, self.random.choice((1, 2, 3, 0x10, 0x91, 0, 0xFF))])
        if report in {1, 2}:
            return bytes([report, self.random.choice((0xFF, 0x08, 0x04, 0, self.random.randrange(256)))])
        if report not in {4, 6}:
            return bytes([report])
        code = self.random.choice([*self.codes, 0x123456]).to_bytes(3, "big")
        return bytes([report]) + code + bytes([self.random.choice((0xFF, 1, 2, 3, 0x10, 0, 0xFE, 0x77))])

    def _security(self) -> bytes:
        if self.seed is not None and self.random.random() < 0.75:
            return self._key(is_right=self.random.random() < self.skill)
        return bytes([self.random.choice((1, 1, 3, 3, 5, 2, 4))])

    def _definition(self) -> bytes:
        periodic = bytes([0xF2, self.random.randrange(0x10, 0x1A)])
        name = self.one_of(b"\xf3\x00", b"\xf3\x01", b"\xf2\x00", periodic, periodic)
        if self.random.random() < 0.3:
            return b"\3" + self.one_of(b"", name)
        places = (b"\1\1", b"\1\1", b"\1\2", b"\2\1", b"\0\1", b"\1\0", b"\1\x09")
        count = self.random.choice((1, 2, 3, 40))
        return b"\1" + name + b"".join(self.number(self.data) + self.one_of(*places) for _ in range(count))

    def _routine(self) -> bytes:
        number: int = self.random.choice([*self.routines, 0x0301, 0x0999])
        options = self.one_of(b"\4\4", b"\4\4", b"\0\4", b"\4") if number == 0x0301 else b""
        sub = self.random.choice((1, 1, 2, 3, 3, 4))
        return bytes([sub]) + number.to_bytes(2, "big") + (options if sub == 1 else b"")

    def _written(self) -> bytes:
        number = self.random.choice(list(self.stored))
        size: int = sum(entry["size_bytes"] for entry in self.stored[number]["fields"])
        letters = self.one_of(b"0123456789", b"ABCXYZ019", b"IOQ", bytes(range(256)))
        return number.to_bytes(2, "big") + bytes(self.random.choices(letters, k=size))

    def heard(self, request: bytes, response: bytes | None) -> None:
        """Remember a seed."""
        if response is None or request[0] != 0x27 or response[0] != 0x67:
            return
        self.seed = (response[1], response[2:]) if response[1] in self.levels else None


def step(pair: Pair, client: RandomClient) -> None:
    """Let one thing happen."""
    random = client.random
    kind = random.random()
    if kind < 0.72:
        request = client.request()
        response = pair.ask(request, random.randbytes(16) or b"", is_functional=random.random() < 0.15)
        client.heard(request, response)
        pair.check_session()
    elif kind < 0.80:
        pair.wait(random.choice((0.0, 0.1, 0.1, 0.1, 0.6, 0.6, 2.0, 3.6, 4.99, 5.0, 11.0, 31.0, 310.0)))
    elif kind < 0.90:
        pair.sample(random.choice(client.codes[:4]), random.choice(RESULTS))
    elif kind < 0.93:
        pair.drive(random)
    elif kind < 0.96:
        pair.finish(random.choice((0x0301, 0x0303, 0x0303)))
    elif kind < 0.97:
        pair.warm_up()
    elif kind < 0.99:
        pair.cycle()
    else:
        pair.restart()
