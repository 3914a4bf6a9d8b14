"""Compressed contents: all of them, cut ones, damaged ones, and those that are a trap."""

import bz2
import gzip
import io
import lzma
import zlib

import pytest
import zstandard

from canlog.errors import SourceError
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.streams import Compression, InflatedStream

TEXT = b"".join(b"(%d.%06d) can0 %03X#%016X\n" % (k, k, k % 0x800, k * 2_654_435_761) for k in range(20_000))
WRAPPED = {
    Compression.GZIP: gzip.compress(TEXT),
    Compression.XZ: lzma.compress(TEXT),
    Compression.BZIP2: bz2.compress(TEXT),
    Compression.ZSTD: zstandard.ZstdCompressor(write_checksum=True).compress(TEXT),
}


def contents(wrapped: bytes, kind: Compression) -> tuple[bytes, LogCounts]:
    counts = LogCounts()
    stream = InflatedStream(io.BytesIO(wrapped), kind, counts)
    buffer, pieces = bytearray(10_007), list[bytes]()
    while got := stream.readinto(buffer):
        pieces.append(bytes(buffer[:got]))
    return b"".join(pieces), counts


@pytest.mark.parametrize("kind", WRAPPED)
def test_streams_may_follow_each_other_with_padding_between(kind: Compression) -> None:
    assert contents(WRAPPED[kind] + bytes(8) + WRAPPED[kind] + bytes(4), kind) == (TEXT + TEXT, LogCounts())


@pytest.mark.parametrize("kind", WRAPPED)
@pytest.mark.parametrize("fraction", [0.1, 0.5, 0.999])
def test_a_cut_file_gives_its_beginning(kind: Compression, fraction: float) -> None:
    wrapped = WRAPPED[kind][: int(fraction * len(WRAPPED[kind]))]
    found, counts = contents(wrapped, kind)
    assert TEXT.startswith(found)
    assert counts.truncated
    assert counts.rejected == {LogReject.CUT_OFF: 1}
    assert counts.first_rejected == f"byte {len(wrapped)} of the {kind} file: cut_off"


@pytest.mark.parametrize("kind", WRAPPED)
def test_damage_is_found_by_the_checksum_if_by_nothing_else(kind: Compression) -> None:
    wrapped = bytearray(WRAPPED[kind])
    wrapped[len(wrapped) // 2] ^= 0x10
    _, counts = contents(bytes(wrapped), kind)
    assert counts.rejected == {LogReject.DAMAGED: 1}


def test_a_bomb_is_refused() -> None:
    bomb = zlib.compressobj(9, zlib.DEFLATED, 31)
    wrapped = b"".join(bomb.compress(bytes(1 << 20)) for _ in range(256)) + bomb.flush()
    with pytest.raises(SourceError, match="256 times its size"):
        contents(wrapped, Compression.GZIP)
