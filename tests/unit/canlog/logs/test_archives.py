"""Zip archives: which of their files is meant, what is refused, and what damage does."""

import bz2
import gzip
import io
import lzma
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import pytest
import zstandard

from canlog.errors import SourceError
from canlog.logs import LogReject, is_folder, looked_at, read_log
from canlog.logs.archives import END_MAGIC, MOST_MEMBERS
from canlog.logs.log_counts import LogCounts

LOG = b"".join(
    b"(%d.%03d000) can0 %03X#%016X\n" % (k // 1_000, k % 1_000, k % 0x800, k * 2_654_435_761) for k in range(3_000)
)


def zipped(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, contents in members.items():
            archive.writestr(name, contents)
    return stream.getvalue()


def frames(path: Path) -> tuple[int, LogCounts]:
    reader = read_log(path)
    return sum(len(batch) for batch in reader), reader.counts


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_the_only_log_of_an_archive_is_meant(method: int, tmp_path: Path) -> None:
    path = tmp_path / "drive.zip"
    path.write_bytes(
        zipped({"read me.txt": b"On the second day.", "day 2/drive.log": LOG, "picture": b"\x89PNG"}, method)
    )
    assert frames(path) == (3_000, LogCounts(frames=3_000))
    assert frames(path / "day 2/drive.log")[0] == 3_000


def test_one_of_several_is_meant_by_its_path(tmp_path: Path) -> None:
    path = tmp_path / "drives.zip"
    path.write_bytes(zipped({"a.log": LOG, "/b.log": LOG[: LOG.index(b"(1.500000)")], "c\\d.log": LOG}))
    with pytest.raises(
        SourceError, match=r"drives\.zip: the zip archive holds 3 logs \(a\.log, b\.log, c/d\.log\): name one"
    ):
        read_log(path)
    assert frames(path / "b.log")[0] == 1_500
    assert frames(path / "c" / "d.log")[0] == 3_000
    with pytest.raises(SourceError, match=r"holds no e\.log"):
        read_log(path / "e.log")
    (tmp_path / "plain.log").write_bytes(LOG)
    with pytest.raises(SourceError, match="it is a file, not an archive"):
        read_log(tmp_path / "plain.log" / "a.log")


def encrypted() -> bytes:
    contents = bytearray(zipped({"drive.log": LOG}))
    contents[6] |= 1
    place = contents.rfind(b"PK\x01\x02")
    contents[place + 8] |= 1
    return bytes(contents)


def tarred(members: dict[str, bytes], packing: str = "", form: int = tarfile.PAX_FORMAT) -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w", format=form) as archive:
        for name, contents in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(contents)
            archive.addfile(info, io.BytesIO(contents))
    return PACKED_BY[packing](stream.getvalue())


PACKED_BY: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "gz": gzip.compress,
    "bz2": bz2.compress,
    "xz": lzma.compress,
    "zst": zstandard.ZstdCompressor().compress,
}


def tar_of(kind: bytes, **fields: object) -> bytes:
    """Return an archive of a log and of something that is no file."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        other = tarfile.TarInfo("other.log")
        other.type, other.linkname = kind, "/etc/passwd"
        for name, value in fields.items():
            setattr(other, name, value)
        archive.addfile(other)
    return stream.getvalue()


@pytest.mark.parametrize("packing", PACKED_BY)
@pytest.mark.parametrize("form", [tarfile.USTAR_FORMAT, tarfile.GNU_FORMAT, tarfile.PAX_FORMAT])
def test_logs_in_a_tar_archive_are_read_like_those_in_a_zip_archive(packing: str, form: int, tmp_path: Path) -> None:
    path = tmp_path / f"drives.tar.{packing}"
    deep = f"{'d' * 90}/{'e' * 40}.log"
    path.write_bytes(tarred({"read me.txt": b"On the second day.", "a.log": LOG, deep: LOG[:51_000]}, packing, form))
    assert is_folder(path)
    assert [str(one.path.relative_to(path)) for one in looked_at(path) if not one.reason] == ["a.log", deep]
    with pytest.raises(SourceError, match=r"the tar archive holds 2 logs \(a\.log, d+/e+\.log\): name one"):
        read_log(path)
    assert frames(path / "a.log") == (3_000, LogCounts(frames=3_000))
    assert frames(path / deep)[0] == LOG[:51_000].count(b"\n")
    with pytest.raises(SourceError, match=r"holds no e\.log"):
        read_log(path / "e.log")
    (tmp_path / "one").write_bytes(tarred({"a.log": LOG}, packing, form))
    assert frames(tmp_path / "one")[0] == 3_000
    assert not is_folder(tmp_path / "one")


@pytest.mark.parametrize(
    ("contents", "reason"),
    [
        (tar_of(tarfile.SYMTYPE), "other.log: it is a link"),
        (tar_of(tarfile.LNKTYPE), "other.log: it is a link"),
        (tar_of(tarfile.CHRTYPE), "it is a device or the like"),
        (tarred({"day/../../drive.log": LOG}), "its name leads out of the archive"),
        (tarred({"inner.tar": tarred({"drive.log": LOG})}), "packed twice: tar inside inner.tar in the tar archive"),
        (gzip.compress(tarred({"drive.log": LOG}, "xz")), "packed twice: xz inside the gzip file"),
        (tarred({f"{k}": b"" for k in range(MOST_MEMBERS + 1)}), "more than 1000 files"),
        (tarred({"drive.log": LOG})[:40_000], "the tar archive is damaged"),
        (tarred({"drive.log": LOG}, "gz")[:-3_000], "the tar archive is damaged"),
        (tarred({"a.log": LOG, "b.log": LOG}).replace(b"b.log\0", b"b.lo?\0"), "not a header"),
        (tarred({"drive.log": LOG + bytes(100 << 20)}, "gz"), "more than 256 times its size"),
        (tar_of(tarfile.XHDTYPE, size=1 << 30), "the tar archive has a header of 10737"),
        (tar_of(tarfile.REGTYPE, pax_headers={"size": "-512"}), "damaged"),
        (tar_of(tarfile.REGTYPE, size=1 << 40), "damaged"),
    ],
)  # fmt: skip
def test_what_is_refused_of_a_tar_archive_has_a_reason(contents: bytes, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.tar"
    path.write_bytes(contents)
    with pytest.raises(SourceError, match=reason):
        list(read_log(path))


def vast_directory() -> bytes:
    contents = bytearray(zipped({"drive.log": LOG}))
    struct.pack_into("<L", contents, contents.rfind(END_MAGIC) + 12, 1 << 30)
    return bytes(contents)


@pytest.mark.parametrize(
    ("contents", "reason"),
    [
        (zipped({}), "holds no log"),
        (zipped({"a.txt": b"What was measured on the second day"}), "holds no log: a.txt: not a log of a known format"),
        (encrypted(), "it is encrypted: unpack it first"),
        (zipped({"day/../../drive.log": LOG}), "its name leads out of the archive"),
        (zipped({"..\\drive.log": LOG}), "its name leads out of the archive"),
        (zipped({"@@@": LOG}).replace(b"@@@", b"\0@@"), "it has no name: unpack it first"),
        (zipped({"drive.log": LOG}, zipfile.ZIP_LZMA), "packed by method 14, not by deflate"),
        (zipped({"inner.zip": zipped({"drive.log": LOG})}), "packed twice: zip inside inner.zip in the zip archive"),
        (zipped({"drive.log.gz": gzip.compress(LOG)}), "packed twice: gzip inside drive.log.gz"),
        (gzip.compress(zipped({"drive.log": LOG})), "packed twice: zip inside the gzip file"),
        (gzip.compress(gzip.compress(LOG)), "packed twice: gzip inside the gzip file"),
        (zipped({f"{k}": b"" for k in range(MOST_MEMBERS + 1)}), "holds 1001 files; more than 1000"),
        (vast_directory(), "lists 1073741824 bytes of names"),
        (zipped({"drive.log": LOG})[:-30], "cut off: its directory is missing"),
        (zipped({"bomb.log": LOG + bytes(100 << 20)}), "more than 256 times its size"),
    ],
)  # fmt: skip
def test_what_is_refused_has_a_reason(contents: bytes, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.zip"
    path.write_bytes(contents)
    with pytest.raises(SourceError, match=reason) as refusal:
        list(read_log(path))
    assert "\n" not in str(refusal.value)


def test_a_damaged_member_gives_what_comes_before(tmp_path: Path) -> None:
    path = tmp_path / "drive.zip"
    contents = bytearray(zipped({"drive.log": LOG * 10}))
    contents[len(contents) // 2] ^= 0xFF
    path.write_bytes(contents)
    count, counts = frames(path)
    assert 0 < count < 30_000
    assert counts.truncated
    assert counts.rejected[LogReject.DAMAGED] == 1
    assert "drive.log in the zip archive" in counts.first_rejected


def named(name: bytes, extra: bytes = b"", flags: int = 0) -> bytes:
    """Return an archive of a log whose name has these bytes, with this extra field and these flags, made on Unix."""
    stand_in = b"@" * len(name)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        info = zipfile.ZipInfo(stand_in.decode())
        info.extra, info.create_system = extra, 3
        archive.writestr(info, LOG)
    contents = bytearray(stream.getvalue().replace(stand_in, name))
    struct.pack_into("<H", contents, 6, flags)
    struct.pack_into("<H", contents, contents.rfind(b"PK\1\2") + 8, flags)
    return bytes(contents)


def unicode_path(raw: bytes, name: str) -> bytes:
    """Return the extra field in which Info-ZIP keeps a name in UTF-8."""
    body = struct.pack("<BL", 1, zlib.crc32(raw)) + name.encode()
    return struct.pack("<HH", 0x7075, len(body)) + body


@pytest.mark.parametrize(
    ("contents", "name"),
    [
        (named("Fahrt Zürich 走行.log".encode()), "Fahrt Zürich 走行.log"),  # of Unix, without a word
        (named("Fahrt Zürich.log".encode(), flags=0x800), "Fahrt Zürich.log"),
        (named(b"Fahrt Z\x81rich.log"), "Fahrt Zürich.log"),  # the code page of DOS
        (named(b"Fahrt #U8d70.log", unicode_path(b"Fahrt #U8d70.log", "Fahrt 走.log")), "Fahrt 走.log"),
        (named(b"a.log", b"\x55\x54\1\0\3" + unicode_path(b"a.log", "ä.log")), "ä.log"),  # behind another field
        (
            named(b"b.log", unicode_path(b"a.log", "ä.log")),
            "b.log",
        ),  # somebody renamed it, who knew nothing of the field
    ],
)
def test_a_name_is_read_as_the_archive_means_it(contents: bytes, name: str, tmp_path: Path) -> None:
    path = tmp_path / "drives.zip"
    path.write_bytes(contents)
    assert [one.path for one in looked_at(path)] == [path / name]
    assert frames(path / name)[0] == 3_000


def test_a_name_in_an_extra_field_does_not_lead_out_either(tmp_path: Path) -> None:
    path = tmp_path / "drives.zip"
    path.write_bytes(named(b"a.log", unicode_path(b"a.log", "../ä.log")))
    assert "its name leads out of the archive" in looked_at(path)[0].reason


def test_the_directory_of_an_archive_is_read_once_for_all_of_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise an archive of twice as many files takes four times as long."""
    path, opened = tmp_path / "drives.zip", []
    path.write_bytes(zipped({f"{k}.log": LOG[:500] for k in range(40)}))

    class Counted(zipfile.ZipFile):
        def __init__(self, file: BinaryIO) -> None:
            opened.append(file)
            super().__init__(file)

    monkeypatch.setattr(zipfile, "ZipFile", Counted)
    assert all(one.format is not None for one in looked_at(path))
    assert len(opened) == 1
    list(read_log(path / "7.log"))
    assert len(opened) == 2
