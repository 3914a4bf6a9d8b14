"""Files are read and written whole, or not at all."""

from pathlib import Path

import pytest

from canlog.errors import OutputError
from canlog.files import read_small_file, replacing
from tests.support.pipes import NO_PLAIN_FILES


def write(path: Path, content: bytes, failure: Exception | None = None) -> None:
    """Write a file; with a failure, half of it."""
    with replacing(path, OutputError) as part:
        part.write_bytes(content)
        if failure is not None:
            raise failure
        part.replace(path)


def names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


def test_a_file_takes_its_place_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(b"before")
    with pytest.raises(KeyError):
        write(path, b"half", KeyError())
    with replacing(path, OutputError) as part:
        part.write_bytes(b"given up")
    assert path.read_bytes() == b"before"
    assert names(tmp_path) == ["table.csv"]
    write(path, b"after")
    assert path.read_bytes() == b"after"
    assert names(tmp_path) == ["table.csv"]


def test_two_who_write_the_same_do_not_mix(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    with replacing(path, OutputError) as first, replacing(path, OutputError) as second:
        first.write_bytes(b"first")
        second.write_bytes(b"second")
        second.replace(path)
        first.replace(path)
    assert path.read_bytes() == b"first"


@pytest.mark.parametrize("kind", NO_PLAIN_FILES)
def test_what_is_no_file_is_refused_at_once(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "it"
    NO_PLAIN_FILES[kind](path)
    with pytest.raises(OSError, match=kind):
        read_small_file(path)


def test_sizes_are_limited_whatever_the_file_system_says(tmp_path: Path) -> None:
    path = tmp_path / "it"
    path.write_bytes(b"12345")
    assert read_small_file(path, 5) == b"12345"
    with pytest.raises(OSError, match="too large"):
        read_small_file(path, 4)
    assert b"Name:" in read_small_file(Path("/proc/self/status"))  # which claims to have no bytes
    with pytest.raises(OSError, match="too large"):
        read_small_file(Path("/proc/self/status"), 4)
