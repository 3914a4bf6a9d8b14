"""A folder of anything: each file is listed with what it was taken for or why not, archives too."""

import gzip
import sqlite3
import zipfile
from contextlib import closing
from pathlib import Path

import pytest

from diag_service.batch.drives import find_drives
from diag_service.cli import main
from ecu_emulator.log_formats import open_log
from tests.support.traffic import START_NS, random_frames

LINES = b"".join(b" (1767225600.%06d)  can0  0A0   [2]  %02X 01\n" % (k * 1_000, k) for k in range(50))
TABLE = b"When,Who,Mood,What\n" + b"".join(b"%d,123,good,FE%02X\n" % (k * 10, k) for k in range(50))
TAKEN = {
    "archive.zip": None,
    "car.dbc": None,
    "drive.blf": "blf",
    "empty.log": None,
    "gone.log": None,
    "letter.pdf": None,
    "odd\\nname.txt": None,
    "other.db": None,
    "packed.blf.gz": "blf",
    "packed twice.gz": None,
    "picture.png": None,
    "table.csv": "columns",
    "torn.blf": "blf",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    with open_log(tmp_path / "drive.blf", start_ns=START_NS) as log:
        log.write(random_frames(50))
    packed = gzip.compress((tmp_path / "drive.blf").read_bytes())
    (tmp_path / "packed.blf.gz").write_bytes(packed)
    with zipfile.ZipFile(tmp_path / "archive.zip", "w") as archive:
        archive.writestr("day 1.log", LINES)
    (tmp_path / "packed twice.gz").write_bytes(gzip.compress(packed))
    (tmp_path / "torn.blf").write_bytes((tmp_path / "drive.blf").read_bytes()[:160])
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    (tmp_path / "letter.pdf").write_bytes(b"%PDF-1.7\n")
    (tmp_path / "table.csv").write_bytes(TABLE)
    (tmp_path / "car.dbc").write_text('VERSION ""\nBU_: A\n', "ascii")
    (tmp_path / "empty.log").touch()
    (tmp_path / "gone.log").symlink_to(tmp_path / "nowhere.log")
    (tmp_path / "odd\nname.txt").write_text("What was measured on the third day", "ascii")
    with closing(sqlite3.connect(tmp_path / "other.db")) as database:
        database.execute("CREATE TABLE cities (name)")
        database.commit()
    return tmp_path


CHOICE = "time=When:ms,id=Who,data=What"


def test_every_file_is_listed_with_what_it_was_taken_for(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(folder), "--columns", CHOICE]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == f"{folder}: 4 logs, 9 other files"
    listed = dict(line.strip().removeprefix(f"{folder}/").split(": ", 1) for line in said[1:14])
    assert {name: text.split(":")[0] for name, text in listed.items()} == {
        name: f"taken for {taken}" if taken else "no log" for name, taken in TAKEN.items()
    }
    assert "packed twice: gzip inside the gzip file" in listed["packed twice.gz"]
    assert listed["archive.zip"] == "no log: a zip archive: unpack it first"
    assert "not a log of a known format" in listed["picture.png"]
    assert "a message database (DBC): it belongs behind --dbc" in listed["car.dbc"]
    assert (listed["empty.log"], listed["gone.log"]) == ("no log: the file is empty", "no log: a broken link")
    assert "if it is a log of python-can, can_logconvert" in listed["other.db"]
    assert any(
        line.startswith(f"{folder}/torn.blf: not a log after all: no CAN frame in this blf log") for line in said
    )
    for name, frames in (("packed.blf.gz", 50), ("table.csv", 50)):
        assert any(line.startswith(f"{folder}/{name}: ") and f", {frames} frames" in line for line in said[14:])


def test_each_log_is_a_drive(folder: Path) -> None:
    drives, left_out = find_drives([folder])
    assert [drive.paths[0].relative_to(folder).as_posix() for drive in drives] == [
        "drive.blf", "packed.blf.gz", "torn.blf",
    ]  # fmt: skip
    assert len({drive.key for drive in drives}) == 3
    assert len(left_out) == 10
