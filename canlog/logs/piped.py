"""Standard input as a log: read as it comes and never sought in; a format that must be sought in is kept in a file."""

import io
import os
import select
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO, Final

from canlog.errors import InputLeftError, SourceError
from canlog.files import WIDE_BYTES, widen

STANDARD_INPUT: Final = Path("-")
INPUT_NAME: Final = "standard input"
HAND_OVER_S: Final = 0.5  # so long at most a frame waits for more to come
LOOK_S: Final = 0.1  # how soon a request to stop is heard


def never() -> bool:
    """Return False: nobody asks to stop."""
    return False


def shown_name(path: Path) -> str:
    return INPUT_NAME if path == STANDARD_INPUT else str(path)


class PipeStream(io.RawIOBase):
    """What comes through a pipe, handed over when a buffer is full, or when what came first has waited long enough.

    Parameters
    ----------
    descriptor : int
        Of the open pipe; it stays open.
    is_stopped
        Whether to wait no longer for what has not come.
    hand_over_s
        How long what came first waits for more.
    file
        To which the descriptor belongs, open as long as this is.
    """

    name = INPUT_NAME
    is_live = True  # a reading that is short has a reason: what there is shall be used now

    def __init__(
        self,
        descriptor: int,
        is_stopped: Callable[[], bool] = never,
        *,
        hand_over_s: float = HAND_OVER_S,
        file: BinaryIO | None = None,
    ) -> None:
        super().__init__()
        self._file = file
        self._descriptor = descriptor
        self._is_stopped = is_stopped
        self._hand_over_s = hand_over_s
        self._returned = b""
        self._has_ended = False
        self.was_left = False  # before its end

    def readable(self) -> bool:
        """Return True."""
        return True

    def close(self) -> None:
        super().close()
        if self._file is not None:
            self._file.close()

    def give_back(self, content: bytes) -> None:
        """Take back what was read; it is the next to be read."""
        self._returned = content + self._returned

    def readinto(self, buffer: "memoryview | bytearray") -> int:  # type: ignore[override]  # any buffer will do
        """Wait for a first byte, then fill the buffer as far as time allows; 0 at the end of the stream."""
        view = memoryview(buffer)
        count = min(len(view), len(self._returned))
        view[:count] = self._returned[:count]
        self._returned = self._returned[count:]
        deadline_s = 0.0 if count else float("inf")  # what was given back has waited before
        while count < len(view) and self._has_more(deadline_s):
            piece = os.read(self._descriptor, min(len(view) - count, WIDE_BYTES))
            if not piece:
                self._has_ended = True
            elif not count:
                deadline_s = time.monotonic() + self._hand_over_s
            view[count : count + len(piece)] = piece
            count += len(piece)
        return count

    def check_not_left(self) -> None:
        """Raise InputLeftError if the stream was left before its end."""
        if self.was_left:
            raise InputLeftError(f"stopped early: {INPUT_NAME} was left before its end")

    def _has_more(self, deadline_s: float) -> bool:
        """Wait until there is something to read, the end included; False if the time is over or nobody wants it."""
        while not self._has_ended:
            wait_s = min(LOOK_S, deadline_s - time.monotonic())
            if wait_s <= 0.0:
                return False
            if _is_ready(self._descriptor, wait_s):
                return True
            if self._is_stopped():
                self._has_ended = self.was_left = True
        return False


def _is_ready(descriptor: int, wait_s: float) -> bool:
    try:
        return bool(select.select([descriptor], [], [], wait_s)[0])
    except (OSError, ValueError):  # a system whose select knows nothing but sockets: reading itself waits
        return True


_WAITING: dict[int, PipeStream] = {}  # of standard input, by its object: it cannot be opened twice


def wait_for_reader(stream: PipeStream) -> None:
    """Let a stream be the standard input that is opened next."""
    _WAITING[id(sys.stdin)] = stream


def open_standard_input(is_stopped: Callable[[], bool] = never) -> PipeStream:
    """Return the standard input of this process; raises SourceError if there is none, or a person sits there."""
    if sys.stdin is None:
        raise SourceError("it is closed")
    if (waiting := _WAITING.pop(id(sys.stdin), None)) is not None:
        return waiting
    if sys.stdin.isatty():
        raise SourceError("it is a terminal; pipe a log into it, as in: candump -L can0 | ...")
    descriptor = sys.stdin.fileno()
    widen(descriptor)
    return PipeStream(descriptor, is_stopped)


class KeptFile(io.BufferedReader):
    """A file that is gone when it is closed, with the folder in which it lies."""

    def __init__(self, folder: "TemporaryDirectory[str]", path: Path) -> None:
        self._folder = folder
        super().__init__(io.FileIO(str(path)))

    def close(self) -> None:
        super().close()
        self._folder.cleanup()


def kept(stream: PipeStream, is_stopped: Callable[[], bool] = never) -> KeptFile:
    """Return a file with all that comes through a pipe.

    Raises
    ------
    InputLeftError
        If the pipe was left before its end.
    OSError
        If the disk does not take it.
    """
    folder = TemporaryDirectory(prefix="clutchdiag-")
    try:
        path = Path(folder.name) / "log"
        with path.open("wb") as file:
            while piece := stream.read(WIDE_BYTES):
                file.write(piece)
                stream.was_left |= is_stopped()
                stream.check_not_left()
        stream.check_not_left()
        return KeptFile(folder, path)
    except BaseException:
        folder.cleanup()
        raise
