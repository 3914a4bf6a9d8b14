"""Which drives files and folders stand for."""

import os
from pathlib import Path

import pytest

from canlog.errors import SourceError
from diag_service.batch.drives import drive_of, find_drives
from diag_service.errors import ConfigError

LINE = b"(1700000000.000000) can0 0A0#0011223344556677\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with two logs, one of them deeper, and a text."""
    (tmp_path / "sub").mkdir()
    (tmp_path / "b.log").write_bytes(LINE)
    (tmp_path / "sub" / "a.dat").write_bytes(LINE * 2)  # told by its content
    (tmp_path / "truth.jsonl").write_text("{}\n", encoding="ascii")
    return tmp_path


def test_every_log_of_a_folder_is_a_drive(folder: Path) -> None:
    drives = find_drives([folder]).drives
    assert [drive.paths for drive in drives] == [(folder / "b.log",), (folder / "sub" / "a.dat",)]
    assert [drive.size_bytes for drive in drives] == [len(LINE), 2 * len(LINE)]


def test_named_logs_are_one_drive_beside_a_folder(folder: Path) -> None:
    drives = find_drives([folder / "b.log", folder / "sub"]).drives
    assert [len(drive.paths) for drive in drives] == [1, 1]
    together = find_drives([folder / "b.log", folder / "sub" / "a.dat"]).drives
    assert [drive.name for drive in together] == [f"{folder / 'b.log'} and 1 more"]


def test_every_file_that_is_no_drive_is_listed_with_its_reason(folder: Path) -> None:
    (folder / "empty.log").touch()
    (folder / "sub" / "old.mf4").write_bytes(b"MDF     3.30    TGT 15.0")
    (folder / "sub" / "notes.txt").write_bytes(
        b"what we measured\n" * 30 + b"  1)  1841 0001 2 00 11\n" + b"more\n" * 9
    )
    (folder / "zipped.zip").write_bytes(b"PK\x03\x04" + bytes(200))
    (folder / "gone.log").symlink_to(folder / "nowhere.log")
    os.mkfifo(folder / "pipe.log")
    found = find_drives([folder])
    assert len(found.drives) == 2
    reasons = {str(one.path.relative_to(folder)): one.reason for one in found.left_out}
    assert list(reasons) == [
        "empty.log", "gone.log", "pipe.log", "sub/notes.txt", "sub/old.mf4", "truth.jsonl", "zipped.zip",
    ]  # fmt: skip
    assert reasons["empty.log"] == "the file is empty"
    assert reasons["pipe.log"] == "it is a pipe, not a plain file"
    assert reasons["gone.log"] == "a broken link"
    assert "before 4" in reasons["sub/old.mf4"]
    assert reasons["sub/notes.txt"].endswith("only 1 of the first 40 lines fit trc")
    assert reasons["zipped.zip"] == "a zip archive: unpack it first"
    assert reasons["truth.jsonl"].startswith("not a log of a known format")


def test_a_folder_without_a_log_names_one_reason(tmp_path: Path) -> None:
    (tmp_path / "a.log").touch()
    with pytest.raises(ConfigError, match=r"holds no log that can be read, for one a.log: the file is empty"):
        find_drives([tmp_path])


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
    found = find_drives([folder])
    assert [drive.paths for drive in found.drives] == [(folder / "b.log",), (folder / "sub" / "a.dat",)]
    assert [(str(one.path.relative_to(folder)), one.reason) for one in found.left_out if one.path.is_symlink()] == [
        ("a link.log", f"a link to {folder / 'b.log'}, which is read already"),
        ("sub/z.log", f"a link to {folder / 'b.log'}, which is read already"),
    ]


def test_a_link_to_a_log_elsewhere_is_a_log_once(folder: Path) -> None:
    inside = folder / "sub"
    for name in ("l.log", "m.log"):
        (inside / name).symlink_to(folder / "b.log")
    found = find_drives([inside])
    assert [drive.paths for drive in found.drives] == [(inside / "a.dat",), (inside / "l.log",)]
    assert [(one.path.name, one.reason) for one in found.left_out] == [
        ("m.log", f"a link to {inside / 'l.log'}, which is read already")
    ]
