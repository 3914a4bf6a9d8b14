"""A tester on a socket that speaks bytes, and an entity with short times for it to speak to."""

import secrets
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import TracebackType
from typing import Any, Self

from tests.support.doip.desk import activation, framed, request
from tests.support.patience import HANG_S
from tests.support.ports import free_port
from tests.support.uds.full_table import full_table
from tests.support.uds.wire import PARKED
from workshop.controller.controller import Controller, MemoryFile
from workshop.controller.doip_server import DoipAddress, DoipServer

MASK = 0x5AA5C33C


@contextmanager
def entity(
    *, store: MemoryFile | None = None, port: int = 0, host: str = "127.0.0.1", reset_s: float = 0.3, **settings: float
) -> Iterator[tuple[Controller, DoipServer]]:
    """Run an entity of a parked car; settings are those of the table."""
    table = full_table()
    quick: dict[str, Any] = {"announce_wait_s": 0.0, "announce_count": 0, **settings}
    table = replace(table, doip=replace(table.doip, **quick), timing=replace(table.timing, reset_s=reset_s))
    controller = Controller(table, values=lambda: PARKED, clock=time.monotonic, chance=secrets.token_bytes, store=store)
    with DoipServer(controller, DoipAddress(host=host, port=port or free_port())) as server:
        yield controller, server


def is_pending(response: str) -> bool:
    """Return whether a response says that another one follows."""
    return response.startswith("7f") and response.endswith("78") and len(response) == 8


class Tester:
    """One connection."""

    __test__ = False

    def __init__(self, port: int, address: int = 0x0E00, *, is_activated: bool = True) -> None:
        self.address = address
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=HANG_S)
        if is_activated:
            self.send(activation(address))
            assert self.message()[1][4] == 0x10

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.socket.close()

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def message(self) -> tuple[int, bytes]:
        """Return type and payload of the next message; an alive check is answered on the way."""
        header = self._exactly(8)
        kind, payload = int.from_bytes(header[2:4], "big"), self._exactly(int.from_bytes(header[4:8], "big"))
        if kind == 7:
            self.send(framed(8, self.address.to_bytes(2, "big")))
            return self.message()
        return kind, payload

    def first(self, data: str) -> str:
        """Return the first response to a request, which must have been acknowledged before."""
        self.send(request(data, self.address))
        kind, payload = self.message()
        assert (kind, payload[4]) == (0x8002, 0)
        return self.response()

    def ask(self, data: str) -> str:
        """Return the final response to a request; a machine that is busy says 78 before."""
        told = self.first(data)
        return self.final() if is_pending(told) else told

    def final(self) -> str:
        """Return the next response that is not 78."""
        while is_pending(told := self.response()):
            pass
        return told

    def response(self) -> str:
        """Return the next response of the controller."""
        kind, payload = self.message()
        assert (kind, payload[:4]) == (0x8001, b"\x10\x11" + self.address.to_bytes(2, "big"))
        return payload[4:].hex(" ")

    def unlock(self) -> None:
        """Enter the extended session and open its lock."""
        self.ask("10 03")
        seed = self.ask("27 01").split()[2:]
        key = int("".join(seed), 16) ^ MASK
        assert self.ask(f"27 02 {key:08x}") == "67 02"

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            data += (piece := self.socket.recv(count - len(data)))
            if not piece:
                raise ConnectionError("closed")
        return data
