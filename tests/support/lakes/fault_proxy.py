"""A relay in front of a server that refuses or stalls when told to."""

import socket
import threading
import time
from enum import StrEnum
from typing import Final, Self

_BLOCK: Final = 1 << 16


class Fault(StrEnum):
    """What the relay does to connections."""

    NONE = "none"
    REFUSE = "refuse"  # new ones are closed at once, those that are open at their next byte
    SLOW = "slow"  # every block waits


class FaultProxy:
    """A relay on a port of its own while this is entered.

    Parameters
    ----------
    target_port : int
        The server's, on this machine.
    delay_s : float
        How long a block waits when it is slow.
    """

    def __init__(self, target_port: int, *, delay_s: float = 0.5) -> None:
        self.fault = Fault.NONE
        self.refused = 0
        self.delayed = 0
        self._target_port = target_port
        self._delay_s = delay_s
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]

    def __enter__(self) -> Self:
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            if self.fault is Fault.REFUSE:
                self.refused += 1
                near.close()
                continue
            far = socket.create_connection(("127.0.0.1", self._target_port))
            for source, target in ((near, far), (far, near)):
                threading.Thread(target=self._relay, args=(source, target), daemon=True).start()

    def _relay(self, source: socket.socket, target: socket.socket) -> None:
        try:
            while block := source.recv(_BLOCK):
                if self.fault is Fault.REFUSE:
                    self.refused += 1
                    break
                if self.fault is Fault.SLOW:
                    self.delayed += 1
                    time.sleep(self._delay_s)
                target.sendall(block)
        except OSError:
            pass
        for one in (source, target):
            try:
                one.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue
