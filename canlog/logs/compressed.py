"""Logs inside gzip or xz, inflated piece by piece; what would grow beyond reason is refused."""

import io
import lzma
import zlib
from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import BinaryIO

from canlog.errors import SourceError
from canlog.logs.log_counts import LogCounts, LogReject


class Compression(StrEnum):
    """What a file may be wrapped in."""

    GZIP = "gzip"
    XZ = "xz"


MAGICS: Mapping[bytes, Compression] = MappingProxyType(
    {b"\x1f\x8b\x08": Compression.GZIP, b"\xfd7zXZ\0": Compression.XZ}
)
LONGEST_MAGIC = max(len(magic) for magic in MAGICS)
PIECE_BYTES = 64 * 1024
MOST_RATIO = 256  # logs shrink by a factor of 5 to 50
FREE_BYTES = 64 * 1024 * 1024  # may come of any piece, however small
XZ_MEMORY_BYTES = 192 * 1024 * 1024  # the highest preset asks for 65 MiB
GZIP_WINDOW = 31  # zlib's number for its largest window and a gzip header


class _Gzip:
    """As `lzma.LZMADecompressor`: keeps what it was given and did not come to."""

    def __init__(self) -> None:
        self._inner = zlib.decompressobj(GZIP_WINDOW)

    @property
    def eof(self) -> bool:
        return self._inner.eof

    @property
    def unused_data(self) -> bytes:
        return self._inner.unused_data

    def decompress(self, piece: bytes, max_length: int) -> bytes:
        return self._inner.decompress(self._inner.unconsumed_tail + piece, max_length)


def new_inflater(kind: Compression) -> "_Gzip | lzma.LZMADecompressor":
    """Return what inflates one compressed stream."""
    return _Gzip() if kind is Compression.GZIP else lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=XZ_MEMORY_BYTES)


def compression_of(probe: bytes) -> Compression | None:
    """Return what the first bytes of a file say it is wrapped in."""
    return next((kind for magic, kind in MAGICS.items() if probe.startswith(magic)), None)


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
        self._kind = compression
        self.restart(LogCounts())

    def restart(self, counts: LogCounts) -> None:
        """Begin again, and count damage here from now on."""
        self._stream.seek(0)
        self._counts = counts
        self._inflater: _Gzip | lzma.LZMADecompressor | None = new_inflater(self._kind)
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
            contents = inflater.decompress(b"", most_bytes)
            if not contents and not inflater.eof:
                contents = inflater.decompress(self._piece(), most_bytes)
        except (zlib.error, lzma.LZMAError, EOFError) as exc:
            self._end(LogReject.CUT_OFF if isinstance(exc, EOFError) else LogReject.DAMAGED)
            return b""
        if inflater.eof:
            self._follow(inflater.unused_data)
        self._given_bytes += len(contents)
        if self._given_bytes > FREE_BYTES + MOST_RATIO * self._taken_bytes:
            raise SourceError(f"the {self._kind} file holds more than {MOST_RATIO} times its size: no log does")
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
            if compression_of(self._stream.read(LONGEST_MAGIC)) is not self._kind:
                self._end(LogReject.DAMAGED)
                return
            self._stream.seek(position)
            self._inflater = new_inflater(self._kind)

    def _end(self, reason: LogReject) -> None:
        self._inflater = None
        self._counts.truncated = True
        self._counts.reject(reason, f"byte {self._stream.tell()} of the {self._kind} file")
