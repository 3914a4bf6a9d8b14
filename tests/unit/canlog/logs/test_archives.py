"""Archives are not read: each is refused with what to do about it, compressed as a whole or not."""

import gzip
import io
import lzma
import tarfile
import zipfile
from pathlib import Path

import pytest

from canlog.errors import SourceError
from canlog.logs import looked_at, read_log

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
