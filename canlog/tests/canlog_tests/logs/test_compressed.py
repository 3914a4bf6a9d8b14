"""Compressed logs and archives."""

import bz2
import gzip
import io
import lzma
import tarfile
import zipfile
import zlib
from pathlib import Path

import pytest
import zstandard

from canlog.errors import SourceError
from canlog.logs import looked_at, read_log
from canlog.logs.detection import detect
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


LOG = b"(1700000000.000000) can0 0A0#0011223344556677\n" * 50


def zipped() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("drive.log", LOG)
    return stream.getvalue()


def tarred(form: int) -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w", format=form) as archive:
        info = tarfile.TarInfo("drive.log")
        info.size = len(LOG)
        archive.addfile(info, io.BytesIO(LOG))
    return stream.getvalue()


@pytest.mark.parametrize(
    ("contents", "kind"),
    [
        (zipped(), "zip"),
        (b"PK\x05\x06" + bytes(18), "zip"),
        (gzip.compress(zipped()), "zip"),
        *((tarred(form), "tar") for form in (tarfile.USTAR_FORMAT, tarfile.GNU_FORMAT, tarfile.PAX_FORMAT)),
        (gzip.compress(tarred(tarfile.PAX_FORMAT)), "tar"),
        (lzma.compress(tarred(tarfile.GNU_FORMAT)), "tar"),
        (b"7z\xbc\xaf\x27\x1c" + bytes(90), "7z"),
        (b"Rar!\x1a\x07\x01\x00" + bytes(90), "RAR"),
    ],
)
def test_an_archive_is_refused_with_what_to_do(contents: bytes, kind: str, tmp_path: Path) -> None:
    path = tmp_path / "drives"
    path.write_bytes(contents)
    said = f"a {kind} archive: unpack it first"
    with pytest.raises(SourceError, match=f"^{path}: {said}$"):
        read_log(path)
    assert looked_at(path).reason == said


def test_a_database_of_frames_is_refused_with_what_converts_it() -> None:
    with pytest.raises(SourceError, match="can_logconvert makes a BLF of it"):
        detect(b"SQLite format 3\0" + bytes(84))
