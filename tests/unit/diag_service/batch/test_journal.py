"""A batch: its drives, its journal and its tables."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from canlog.errors import SourceError
from clutch_results.records import shift_record
from diag_service.batch.drives import drive_of, find_drives
from diag_service.batch.tables import Entry, Journal, columns, flattened, write_results
from diag_service.errors import ConfigError, StoreError
from tests.support.builders import rejected, shift_result


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


LINE = b"(1700000000.000000) can0 0A0#0011223344556677\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with two logs, one of them deeper, and a text."""
    (tmp_path / "sub").mkdir()
    (tmp_path / "b.log").write_bytes(LINE)
    (tmp_path / "sub" / "a.dat").write_bytes(LINE * 2)  # told by its content
    (tmp_path / "truth.jsonl").write_text("{}\n", encoding="ascii")
    return tmp_path


def test_named_logs_are_one_drive_beside_a_folder(folder: Path) -> None:
    drives, _ = find_drives([folder / "b.log", folder / "sub"])
    assert [len(drive.paths) for drive in drives] == [1, 1]
    together, _ = find_drives([folder / "b.log", folder / "sub" / "a.dat"])
    assert [drive.name for drive in together] == [f"{folder / 'b.log'} and 1 more"]


def test_a_file_that_changed_is_another_drive(folder: Path) -> None:
    before = drive_of([folder / "b.log"])
    assert drive_of([folder / "b.log"]).key == before.key
    os.utime(folder / "b.log", ns=(1, 1))
    assert drive_of([folder / "b.log"]).key != before.key


def test_what_stands_for_nothing_is_refused(folder: Path) -> None:
    with pytest.raises(ConfigError, match="named twice"):
        find_drives([folder, folder / "b.log"])
    with pytest.raises(SourceError, match="No such file"):
        find_drives([folder / "none.log"])
    (folder / "empty").mkdir()
    with pytest.raises(ConfigError, match="holds no log"):
        find_drives([folder / "empty"])


def test_a_link_to_a_log_of_the_folder_is_left_out_and_its_log_is_read_once(folder: Path) -> None:
    (folder / "a link.log").symlink_to(folder / "b.log")
    (folder / "sub" / "z.log").symlink_to("../b.log")
    drives, left_out = find_drives([folder])
    assert [drive.paths for drive in drives] == [(folder / "b.log",), (folder / "sub" / "a.dat",)]
    assert [(str(one.path.relative_to(folder)), one.reason) for one in left_out if one.path.is_symlink()] == [
        ("a link.log", f"a link to {folder / 'b.log'}, which is read already"),
        ("sub/z.log", f"a link to {folder / 'b.log'}, which is read already"),
    ]


ENTRIES = tuple(
    Entry(key=str(seq), drive={"paths": [f"{seq}.log"]}, shifts=(shift_record(result),))
    for seq, result in enumerate((shift_result(1), rejected(shift_result(2))))
)


def test_a_row_has_columns_of_the_schema_only() -> None:
    row = {"path": "a.log", **flattened(shift_record(shift_result()))}
    assert row.keys() - {"indices", "verdict.lining", "verdict.stick_slip"} <= columns().keys()  # null as a whole
    assert columns()["friction.mu_c"] == "float64"
    assert columns()["clutch"] == columns()["tier"] == columns()["seq"] == "int64"
    assert columns()["reasons"] == columns()["status"] == "string"


@pytest.mark.parametrize("name", ["out.jsonl", "out.csv", "out.parquet"])
def test_a_file_that_cannot_be_completed_does_not_appear(tmp_path: Path, name: str) -> None:
    def broken() -> Iterator[Entry]:
        yield ENTRIES[0]
        raise OSError(28, "No space left on device")

    (tmp_path / name).write_bytes(b"before")
    with pytest.raises(StoreError, match="No space left"):
        write_results(tmp_path / name, broken())
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_bytes() == b"before"
