"""What inflates one compressed stream, the same for every compression: piece by piece, never more than asked for."""

import bz2
import lzma
import zlib
from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Protocol

from canlog.extras import load_extra


class Compression(StrEnum):
    """What a file may be wrapped in."""

    GZIP = "gzip"
    XZ = "xz"
    BZIP2 = "bzip2"
    ZSTD = "zstd"


MAGICS: Mapping[bytes, Compression] = MappingProxyType(
    {
        b"\x1f\x8b\x08": Compression.GZIP,
        b"\xfd7zXZ\0": Compression.XZ,
        **{b"BZh%d1AY&SY" % level: Compression.BZIP2 for level in range(1, 10)},
        **{b"BZh%d\x17\x72\x45\x38\x50\x90" % level: Compression.BZIP2 for level in range(1, 10)},  # of nothing
        b"\x28\xb5\x2f\xfd": Compression.ZSTD,
        **{bytes([kind]) + b"\x2a\x4d\x18": Compression.ZSTD for kind in range(0x50, 0x60)},  # a frame to be skipped
    }
)
LONGEST_MAGIC = max(len(magic) for magic in MAGICS)
XZ_MEMORY_BYTES = 192 * 1024 * 1024  # the highest preset asks for 65 MiB
ZSTD_WINDOW_BYTES = 128 * 1024 * 1024  # what zstd itself takes without being told to take more
GZIP_WINDOW = 31  # zlib's number for its largest window and a gzip header
ZSTD_PIECE_BYTES = 256  # inflate to no more than 8 MiB: four bytes can stand for 128 KiB


class Inflater(Protocol):
    """As `lzma.LZMADecompressor`: it keeps what it was given and did not come to."""

    @property
    def eof(self) -> bool:
        """Whether the stream has ended."""

    @property
    def unused_data(self) -> bytes:
        """What it was given of whatever follows the stream."""

    def decompress(self, data: bytes, max_length: int = -1) -> bytes:
        """Take more of the stream; return no more than so many bytes of its contents."""


class DamagedStreamError(Exception):
    """What is compressed is damaged, whichever library says so."""


class _Gzip:
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


def new_inflater(kind: Compression) -> Inflater:
    """Return what inflates one compressed stream; raises ExtraMissingError if its library is not installed."""
    if kind is Compression.GZIP:
        return _Gzip()
    if kind is Compression.BZIP2:
        return bz2.BZ2Decompressor()
    if kind is Compression.ZSTD:
        return _Zstd()
    return lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=XZ_MEMORY_BYTES)


def inflated(inflater: Inflater, data: bytes, most_bytes: int) -> bytes:
    """Return what an inflater makes of more data; raises DamagedStreamError where the stream is damaged."""
    try:
        return inflater.decompress(data, most_bytes)
    except (zlib.error, lzma.LZMAError, OSError) as exc:  # the last one: bzip2
        raise DamagedStreamError(str(exc)) from exc


def compression_of(probe: bytes) -> Compression | None:
    """Return what the first bytes of a file say it is wrapped in."""
    return next((kind for magic, kind in MAGICS.items() if probe.startswith(magic)), None)
