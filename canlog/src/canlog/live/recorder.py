"""The frames of a bus as python-can has them, kept for who looks at them one by one, such as a test."""

import threading
import time
from typing import Final, Self

import can

from canlog.errors import SourceError
from canlog.live.pythoncan import one_line

POLL_S: Final = 0.05
WAIT_S: Final = 0.01


class FrameRecorder:
    """Keeps the frames of an open bus, in the order in which they come, while the ``with`` block runs.

    Parameters
    ----------
    bus
        It is only read, in a thread of its own, and not closed.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._messages: list[can.Message] = []
        self._is_over = threading.Event()
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._read, name="frame recorder", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join()

    @property
    def messages(self) -> tuple[can.Message, ...]:
        """The frames until now; raises SourceError if the bus has failed."""
        if self._error is not None:
            raise SourceError(f"the bus cannot be read: {one_line(self._error)}") from self._error
        return tuple(self._messages)

    def wait_for(self, count: int, timeout_s: float) -> tuple[can.Message, ...]:
        """Return the frames as soon as there are so many; raises TimeoutError if there are fewer after this time."""
        deadline_s = time.monotonic() + timeout_s
        while len(self.messages) < count:
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"after {timeout_s:g} s {len(self._messages)} frames, {count} were waited for")
            time.sleep(WAIT_S)
        return self.messages

    def wait_until_quiet(self, quiet_s: float, timeout_s: float) -> tuple[can.Message, ...]:
        """Return the frames when none has come for so long; raises TimeoutError if the bus does not fall silent."""
        deadline_s = time.monotonic() + timeout_s
        count, since_s = len(self.messages), time.monotonic()
        while time.monotonic() - since_s < quiet_s:
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"after {timeout_s:g} s frames still come, {len(self._messages)} until now")
            time.sleep(WAIT_S)
            if len(self.messages) != count:
                count, since_s = len(self._messages), time.monotonic()
        return self.messages

    def _read(self) -> None:
        try:
            while not self._is_over.is_set():
                self._take(self._bus.recv(timeout=POLL_S))
            while (message := self._bus.recv(timeout=0.0)) is not None:
                self._take(message)
        except (can.CanError, OSError, ValueError) as exc:
            self._error = exc

    def _take(self, message: can.Message | None) -> None:
        if message is not None:
            self._messages.append(message)
