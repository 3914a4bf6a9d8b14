"""A folder of anything: each file is listed with what it was taken for or why not, archives as folders of their own."""

import gzip
import json
import zipfile
from pathlib import Path

import pytest

from diag_service.batch.drives import find_drives
from diag_service.cli import main
from ecu_emulator.record import open_log
from tests.support.traffic import START_NS, random_frames

LINES = b"".join(b" (1767225600.%06d)  can0  0A0   [2]  %02X 01\n" % (k * 1_000, k) for k in range(50))
TABLE = b"When,Who,Mood,What\n" + b"".join(b"%d,123,good,FE%02X\n" % (k * 10, k) for k in range(50))
TAKEN = {
    "archive.zip/day 1.log": "candump-console",
    "archive.zip/inner/day 2.blf.gz": None,
    "archive.zip/notes.txt": None,
    "broken.zip": None,
    "drive.blf": "blf",
    "letter.pdf": None,
    "packed.blf.gz": "blf",
    "picture.png": None,
    "table.csv": "columns",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    with open_log(tmp_path / "drive.blf", start_ns=START_NS) as log:
        log.write(random_frames(50))
    packed = gzip.compress((tmp_path / "drive.blf").read_bytes())
    (tmp_path / "packed.blf.gz").write_bytes(packed)
    with zipfile.ZipFile(tmp_path / "archive.zip", "w") as archive:
        archive.writestr("day 1.log", LINES)
        archive.writestr("inner/day 2.blf.gz", packed)
        archive.writestr("notes.txt", "What was measured on the second day")
    (tmp_path / "broken.zip").write_bytes((tmp_path / "archive.zip").read_bytes()[:200])
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    (tmp_path / "letter.pdf").write_bytes(b"%PDF-1.7\n")
    (tmp_path / "table.csv").write_bytes(TABLE)
    return tmp_path


CHOICE = "time=When:ms,id=Who,data=What"


def test_every_file_is_listed_with_what_it_was_taken_for(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(folder), "--columns", CHOICE]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == f"{folder}: 4 logs, 5 other files"
    listed = dict(line.strip().removeprefix(f"{folder}/").split(": ", 1) for line in said[1:10])
    assert {name: text.split(":")[0] for name, text in listed.items()} == {
        name: f"taken for {taken}" if taken else "no log" for name, taken in TAKEN.items()
    }
    assert "packed twice: gzip inside inner/day 2.blf.gz" in listed["archive.zip/inner/day 2.blf.gz"]
    assert listed["broken.zip"] == "no log: the zip archive is cut off: its directory is missing"
    assert "a picture (PNG)" in listed["picture.png"]
    for name, frames in (("archive.zip/day 1.log", 50), ("packed.blf.gz", 50), ("table.csv", 50)):
        assert any(line.startswith(f"{folder}/{name}: ") and f", {frames} frames" in line for line in said[10:])


def test_programs_are_told_the_same(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(folder), "--json"]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    found = {Path(one["path"]).relative_to(folder).as_posix(): one.get("format") for one in records}
    assert found == {**TAKEN, "table.csv": None}
    (table,) = (one for one in records if one["path"].endswith("table.csv"))
    assert "a table with the columns When, Who, Mood, What; --columns" in table["reason"]


def test_each_log_of_an_archive_is_a_drive(folder: Path) -> None:
    found = find_drives([folder])
    assert [drive.paths[0].relative_to(folder).as_posix() for drive in found.drives] == [
        "archive.zip/day 1.log", "drive.blf", "packed.blf.gz",
    ]  # fmt: skip
    assert len({drive.key for drive in found.drives}) == 3
    assert len(found.left_out) == 6
