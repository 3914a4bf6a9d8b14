"""The journal keeps what is done, drops what a kill cut off, and belongs to one run at a time."""

from pathlib import Path

import pytest

from diag_service.batch.journal import Entry, Journal
from diag_service.errors import StoreError


def entry(key: str) -> Entry:
    return Entry(key=key, drive={"paths": [f"{key}.log"], "error": None}, shifts=({"seq": 1},))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return a journal with two drives."""
    with Journal(tmp_path / "out.journal", "a") as journal:
        journal.add(entry("one"))
        journal.add(entry("two"))
    return tmp_path / "out.journal"


def test_what_is_done_is_found_again(path: Path) -> None:
    with Journal(path, "a") as journal:
        assert list(journal.done) == ["one", "two"]
        assert journal.entry("two") == entry("two")
        journal.add(entry("three"))
        assert journal.entry("three") == entry("three")


@pytest.mark.parametrize("tail", [b'{"schema":"clutchdiag/journal/v1","set', b'{"schema":"cl', b"{broken}\n"])
def test_what_was_cut_off_is_dropped(path: Path, tail: bytes) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole + tail)
    with Journal(path, "a") as journal:
        assert list(journal.done) == ["one", "two"]
        assert path.read_bytes() == whole


def test_drives_of_other_settings_are_not_done(path: Path) -> None:
    with Journal(path, "b") as journal:
        assert journal.done == {}


@pytest.mark.parametrize("content", [b"hello\n", b'{"schema":"other"}\n', b"hello", b"[]\n"])
def test_a_file_of_another_program_is_left_alone(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "out.journal"
    path.write_bytes(content)
    with pytest.raises(StoreError, match="is not a journal"):
        Journal(path, "a")
    assert path.read_bytes() == content


def test_one_run_at_a_time(path: Path) -> None:
    with Journal(path, "a"), pytest.raises(StoreError, match="in use by another run"):
        Journal(path, "a")
