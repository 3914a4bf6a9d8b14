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


def test_named_logs_are_one_drive_beside_a_folder(folder: Path) -> None:
    drives = find_drives([folder / "b.log", folder / "sub"]).drives
    assert [len(drive.paths) for drive in drives] == [1, 1]
    together = find_drives([folder / "b.log", folder / "sub" / "a.dat"]).drives
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
    found = find_drives([folder])
    assert [drive.paths for drive in found.drives] == [(folder / "b.log",), (folder / "sub" / "a.dat",)]
    assert [(str(one.path.relative_to(folder)), one.reason) for one in found.left_out if one.path.is_symlink()] == [
        ("a link.log", f"a link to {folder / 'b.log'}, which is read already"),
        ("sub/z.log", f"a link to {folder / 'b.log'}, which is read already"),
    ]
