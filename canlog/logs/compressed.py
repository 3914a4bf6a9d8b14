"""Logs inside gzip, xz, bzip2 or zstd, inflated piece by piece; what would grow beyond reason is refused."""

import io
from typing import BinaryIO

from canlog.errors import SourceError
from canlog.logs.inflaters import (
    LONGEST_MAGIC,
    Compression,
    DamagedStreamError,
    Inflater,
    compression_of,
    inflated,
    new_inflater,
)
from canlog.logs.log_counts import LogCounts, LogReject

PIECE_BYTES = 64 * 1024
MOST_RATIO = 256  # logs shrink by a factor of 5 to 50
FREE_BYTES = 64 * 1024 * 1024  # may come of any piece, however small


def check_growth(what: str, taken_bytes: int, given_bytes: int) -> None:
    """Raise SourceError if contents are so much larger than what they were packed in that they can be no log."""
    if given_bytes > FREE_BYTES + MOST_RATIO * taken_bytes:
        raise SourceError(f"{what} holds more than {MOST_RATIO} times its size: no log does")


class InflatedStream(io.RawIOBase):
    """The contents of a compressed file, which may be several streams one after the other.

    A stream that is cut or damaged ends the contents and is counted: what follows cannot be found.

    Raises
    ------
    SourceError
        On reading, if the contents are so much larger than the file that they can be no log.
    """

    def __init__(self, stream: BinaryIO, compression: Compression) -> None:
        self._stream = stream
        self.kind = compression
        self.restart(LogCounts())

    @property
    def name(self) -> str:
        """What it is, for people."""
        return f"the {self.kind} file"

    def restart(self, counts: LogCounts) -> None:
        """Begin again, and count damage here from now on."""
        self._stream.seek(0)
        self._counts = counts
        self._inflater: Inflater | None = new_inflater(self.kind)
        self._taken_bytes = 0
        self._given_bytes = 0

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, buffer: "memoryview | bytearray") -> int:  # type: ignore[override]  # any buffer will do
        """Fill the buffer as far as the next piece goes; 0 at the end."""
        view = memoryview(buffer)
        while self._inflater is not None:
            contents = self._next(len(view))
            if contents:
                view[: len(contents)] = contents
                return len(contents)
        return 0

    def close(self) -> None:
        """Close the file."""
        self._stream.close()
        super().close()

    def _next(self, most_bytes: int) -> bytes:
        """Return a few bytes, perhaps none; at the end there is no inflater any more."""
        inflater = self._inflater
        if inflater is None:
            return b""
        try:
            contents = inflated(inflater, b"", most_bytes)
            if not contents and not inflater.eof:
                contents = inflated(inflater, self._piece(), most_bytes)
        except (DamagedStreamError, EOFError) as exc:
            self._end(LogReject.CUT_OFF if isinstance(exc, EOFError) else LogReject.DAMAGED)
            return b""
        if inflater.eof:
            self._follow(inflater.unused_data)
        self._given_bytes += len(contents)
        check_growth(self.name, self._taken_bytes, self._given_bytes)
        return contents

    def _piece(self) -> bytes:
        piece = self._stream.read(PIECE_BYTES)
        if not piece:
            raise EOFError
        self._taken_bytes += len(piece)
        return piece

    def _follow(self, unused: bytes) -> None:
        """Go on with the stream that follows one that ended."""
        following = unused.lstrip(b"\0") or self._stream.read(PIECE_BYTES).lstrip(b"\0")
        self._inflater = None
        if following:
            position = self._stream.tell() - len(following)
            self._stream.seek(position)
            if compression_of(self._stream.read(LONGEST_MAGIC)) is not self.kind:
                self._end(LogReject.DAMAGED)
                return
            self._stream.seek(position)
            self._inflater = new_inflater(self.kind)

    def _end(self, reason: LogReject) -> None:
        self._inflater = None
        self._counts.truncated = True
        self._counts.reject(reason, f"byte {self._stream.tell()} of {self.name}")
