"""Where logs come from: a pipe, read as it comes and never sought in; gzip, xz, bzip2 or zstd, inflated by pieces.

What would grow beyond reason is refused; of a pipe, a format that must be sought in is kept in a file.
"""

import bz2
import codecs
import io
import lzma
import os
import select
import sys
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, Final

from canlog.errors import InputLeftError, SourceError
from canlog.extras import load_extra
from canlog.files import WIDE_BYTES, widen
from canlog.logs.log_counts import LogCounts, LogReject

PIECE_BYTES = 64 * 1024
MOST_AT_ONCE = 2 * 1024 * 1024  # of contents
MOST_RATIO = 256  # logs shrink by a factor of 5 to 50
FREE_BYTES = 64 * 1024 * 1024  # contents that any file may have, however small


class Compression(StrEnum):
    """What a file may be wrapped in."""

    GZIP = "gzip"
    XZ = "xz"
    BZIP2 = "bzip2"
    ZSTD = "zstd"


MAGICS: Mapping[bytes, Compression] = {
    b"\x1f\x8b\x08": Compression.GZIP,
    b"\xfd7zXZ\0": Compression.XZ,
    **{b"BZh%d1AY&SY" % level: Compression.BZIP2 for level in range(1, 10)},
    **{b"BZh%d\x17\x72\x45\x38\x50\x90" % level: Compression.BZIP2 for level in range(1, 10)},  # of an empty file
    b"\x28\xb5\x2f\xfd": Compression.ZSTD,
    **{bytes([kind]) + b"\x2a\x4d\x18": Compression.ZSTD for kind in range(0x50, 0x60)},  # a frame to be skipped
}
LONGEST_MAGIC = max(len(magic) for magic in MAGICS)
XZ_MEMORY_BYTES = 192 * 1024 * 1024  # the highest preset asks for 65 MiB
ZSTD_WINDOW_BYTES = 128 * 1024 * 1024  # the default limit of the program zstd
GZIP_WINDOW = 31  # zlib's number for its largest window and a gzip header
ZSTD_PIECE_BYTES = 256  # inflate to no more than 8 MiB: four bytes can stand for 128 KiB


class DamagedStreamError(Exception):
    """A compressed stream is damaged."""


class _Gzip:
    """As `lzma.LZMADecompressor`, which keeps what it was given and did not come to."""

    def __init__(self) -> None:
        self._inner = zlib.decompressobj(GZIP_WINDOW)

    @property
    def eof(self) -> bool:
        return self._inner.eof

    @property
    def unused_data(self) -> bytes:
        return self._inner.unused_data

    def decompress(self, data: bytes, max_length: int = -1) -> bytes:
        return self._inner.decompress(self._inner.unconsumed_tail + data, max_length)


class _Zstd:
    """zstd gives all that a piece inflates to: the pieces are small, and what was not asked for waits."""

    def __init__(self) -> None:
        zstandard: Any = load_extra("zstandard", "logs inside zstd", extra="zstd")
        self._errors: type[Exception] = zstandard.ZstdError
        self._inner = zstandard.ZstdDecompressor(max_window_size=ZSTD_WINDOW_BYTES).decompressobj()
        self._given, self._taken_bytes = b"", 0
        self._ready = memoryview(b"")

    @property
    def eof(self) -> bool:
        return bool(self._inner.eof) and not self._ready

    @property
    def unused_data(self) -> bytes:
        return bytes(self._inner.unused_data) + self._given[self._taken_bytes :]

    def decompress(self, data: bytes, max_length: int = -1) -> bytes:
        if data:
            self._given, self._taken_bytes = self._given[self._taken_bytes :] + data, 0
        while not self._ready and self._taken_bytes < len(self._given) and not self._inner.eof:
            piece = self._given[self._taken_bytes : self._taken_bytes + ZSTD_PIECE_BYTES]
            self._taken_bytes += len(piece)
            try:
                self._ready = memoryview(self._inner.decompress(piece))
            except self._errors as exc:
                raise DamagedStreamError(str(exc)) from exc
        count = len(self._ready) if max_length < 0 else max_length
        contents, self._ready = bytes(self._ready[:count]), self._ready[count:]
        return contents


Inflater = _Gzip | _Zstd | bz2.BZ2Decompressor | lzma.LZMADecompressor  # of one stream


def new_inflater(kind: Compression) -> Inflater:
    """Return what inflates one compressed stream; raises ExtraMissingError if its library is not installed."""
    if kind is Compression.GZIP:
        return _Gzip()
    if kind is Compression.BZIP2:
        return bz2.BZ2Decompressor()
    if kind is Compression.ZSTD:
        return _Zstd()
    return lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=XZ_MEMORY_BYTES)


def compression_of(probe: bytes) -> Compression | None:
    """Return what the first bytes of a file say it is wrapped in."""
    return next((kind for magic, kind in MAGICS.items() if probe.startswith(magic)), None)


class InflatedStream(io.RawIOBase):
    """The contents of a compressed file, which may be several streams one after the other.

    A stream that is cut or damaged ends the contents and is counted: what follows cannot be found. Without ``counts``
    this is a look, which leaves the file open.

    Raises
    ------
    SourceError
        On reading, if the contents are so much larger than the file that they can be no log.
    """

    def __init__(self, stream: BinaryIO, compression: Compression, counts: LogCounts | None = None) -> None:
        self._stream = stream
        self.kind = compression
        self._is_a_look = counts is None
        self._counts = counts or LogCounts()
        stream.seek(0)
        self._pieces = self._inflated()
        self._rest = memoryview(b"")

    @property
    def name(self) -> str:
        return f"the {self.kind} file"

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: "memoryview | bytearray") -> int:  # type: ignore[override]  # any buffer will do
        """Fill the buffer as far as the next piece goes; 0 at the end."""
        if not self._rest:
            self._rest = memoryview(next(self._pieces, b""))
        count = min(len(buffer), len(self._rest))
        buffer[:count], self._rest = self._rest[:count], self._rest[count:]
        return count

    def close(self) -> None:
        if not self._is_a_look:
            self._stream.close()
        super().close()

    def _inflated(self) -> Iterator[bytes]:
        """Yield the contents of one stream after the other, up to the end or to damage."""
        inflater, packed, taken_bytes, given_bytes = new_inflater(self.kind), b"", 0, 0
        while True:
            try:
                contents = inflater.decompress(packed, MOST_AT_ONCE)
            except (zlib.error, lzma.LZMAError, OSError, DamagedStreamError):  # OSError: of bzip2
                self._end(LogReject.DAMAGED)
                return
            given_bytes += len(contents)
            if given_bytes > FREE_BYTES + MOST_RATIO * taken_bytes:
                raise SourceError(f"{self.name} holds more than {MOST_RATIO} times its size: no log does")
            if contents:
                yield contents
            packed = b""
            if inflater.eof:
                packed = inflater.unused_data.lstrip(b"\0") or self._stream.read(PIECE_BYTES).lstrip(b"\0")
                if not packed:
                    return
                packed += self._stream.read(LONGEST_MAGIC)
                if compression_of(packed) is not self.kind:
                    self._end(LogReject.DAMAGED)
                    return
                inflater = new_inflater(self.kind)
            elif not contents:
                packed = self._stream.read(PIECE_BYTES)
                if not packed:
                    self._end(LogReject.CUT_OFF)
                    return
            taken_bytes += len(packed)

    def _end(self, reason: LogReject) -> None:
        self._counts.truncated = True
        self._counts.reject(reason, f"byte {self._stream.tell()} of {self.name}")


STANDARD_INPUT: Final = Path("-")
INPUT_NAME: Final = "standard input"
HAND_OVER_S: Final = 0.5  # longest wait of a frame for more to come
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
    file
        To which the descriptor belongs, open as long as this is.
    """

    name = INPUT_NAME
    is_live = True  # a short reading shall be used at once

    def __init__(
        self, descriptor: int, is_stopped: Callable[[], bool] = never, *, file: BinaryIO | None = None
    ) -> None:
        super().__init__()
        self._file = file
        self._descriptor = descriptor
        self._is_stopped = is_stopped
        self._returned = b""
        self._has_ended = False
        self.was_left = False  # before its end

    def readable(self) -> bool:
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
        deadline_s = 0.0 if count else float("inf")  # bytes that were given back are not held up again
        while count < len(view) and self._has_more(deadline_s):
            piece = os.read(self._descriptor, min(len(view) - count, WIDE_BYTES))
            if not piece:
                self._has_ended = True
            elif not count:
                deadline_s = time.monotonic() + HAND_OVER_S
            view[count : count + len(piece)] = piece
            count += len(piece)
        return count

    def pieces(self, is_stopped: Callable[[], bool]) -> Iterator[bytes]:
        """Yield all that comes; raises InputLeftError if the stream is left before its end."""
        while piece := self.read(WIDE_BYTES):
            yield piece
            self.was_left |= is_stopped()
            self.check_not_left()
        self.check_not_left()

    def check_not_left(self) -> None:
        """Raise InputLeftError if the stream was left before its end."""
        if self.was_left:
            raise InputLeftError(f"stopped early: {INPUT_NAME} was left before its end")

    def _has_more(self, deadline_s: float) -> bool:
        """Wait for bytes or the end of the pipe; return False at the deadline, or if a stop was requested."""
        while not self._has_ended:
            wait_s = min(LOOK_S, deadline_s - time.monotonic())
            if wait_s <= 0.0:
                return False
            try:
                if select.select([self._descriptor], [], [], wait_s)[0]:
                    return True
            except (OSError, ValueError):  # select takes sockets only on this system: reading itself waits
                return True
            if self._is_stopped():
                self._has_ended = self.was_left = True
        return False


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


class TemporaryLog(io.BufferedReader):
    """A file that is gone when it is closed, with the folder in which it lies."""

    def __init__(self, folder: "TemporaryDirectory[str]", path: Path) -> None:
        self._folder = folder
        super().__init__(io.FileIO(str(path)))

    def close(self) -> None:
        super().close()
        self._folder.cleanup()


def as_utf_8(stream: BinaryIO, encoding: str) -> Iterator[bytes]:
    """Yield a text in UTF-8, without a byte-order mark; what cannot be decoded becomes a replacement character."""
    pieces = codecs.iterdecode(iter(lambda: stream.read(WIDE_BYTES), b""), encoding, errors="replace")
    for number, piece in enumerate(pieces):
        yield (piece.removeprefix("\ufeff") if number == 0 else piece).encode()


def temporary_log(pieces: Iterable[bytes]) -> TemporaryLog:
    """Return a file with all pieces; raises OSError if the disk does not take them."""
    folder = TemporaryDirectory(prefix="clutchdiag-")
    try:
        path = Path(folder.name) / "log"
        with path.open("wb") as file:
            file.writelines(pieces)
        return TemporaryLog(folder, path)
    except BaseException:
        folder.cleanup()
        raise
