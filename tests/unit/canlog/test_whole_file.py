"""A file is there whole, or as it was."""

from pathlib import Path

import pytest

from canlog.errors import OutputError
from canlog.files import replacing


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
