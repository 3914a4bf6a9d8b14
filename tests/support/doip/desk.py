"""The pure part of an entity without sockets: bytes in, bytes out as hexadecimal text, the time in the test's hands."""

from collections.abc import Iterable

from workshop.controller.doip import Ask, Close, Send, Step, opened, received
from workshop.controller.table import DoipEntity

ENTITY = DoipEntity()


def framed(payload_type: int, payload: str | bytes = b"", version: int = 3) -> bytes:
    """Return a message, written without the product's help."""
    data = bytes.fromhex(payload) if isinstance(payload, str) else payload
    return bytes([version, 255 - version]) + payload_type.to_bytes(2, "big") + len(data).to_bytes(4, "big") + data


def activation(tester: int = 0x0E00, kind: int = 0, version: int = 3) -> bytes:
    return framed(5, tester.to_bytes(2, "big") + bytes([kind, 0, 0, 0, 0]), version)


def request(data: str | bytes, tester: int = 0x0E00, target: int = 0x1011) -> bytes:
    payload = bytes.fromhex(data) if isinstance(data, str) else data
    return framed(0x8001, tester.to_bytes(2, "big") + target.to_bytes(2, "big") + payload)


class Desk:
    """Connections by number."""

    def __init__(self, entity: DoipEntity = ENTITY) -> None:
        self.entity = entity
        self.t_s = 100.0
        self.step = Step(sockets={})
        self.asked: list[Ask] = []
        self.closed: list[int] = []
        self._heard: dict[int, bytes] = {}

    def open(self, *numbers: int) -> None:
        for number in numbers:
            self.step = opened(self.step, number, self.t_s)

    def put(self, number: int, *pieces: bytes) -> str:
        """Let bytes come in, in these pieces; return what that connection was told."""
        for data in pieces:
            self._do(received(self.entity, self.step, number, data, self.t_s))
        return self.told(number)

    def told(self, number: int) -> str:
        """Return what a connection was told since it was asked for last."""
        return self._heard.pop(number, b"").hex()

    def _do(self, step: Step) -> None:
        self.step = step.done()
        for action in step.actions:
            match action:
                case Send(number=number, data=data):
                    self._heard[number] = self._heard.get(number, b"") + data
                case Ask():
                    self.asked.append(action)
                case Close(number=number):
                    self.closed.append(number)


def messages_in(data: bytes) -> Iterable[tuple[int, bytes]]:
    """Yield type and payload of every message in what an entity said."""
    place = 0
    while place < len(data):
        end = place + 8 + int.from_bytes(data[place + 4 : place + 8], "big")
        assert data[place] == 255 - data[place + 1]
        assert end <= len(data)
        yield int.from_bytes(data[place + 2 : place + 4], "big"), data[place + 8 : end]
        place = end
