"""Nothing is written over a file unless that is asked for, and a run that fails leaves no store behind."""

from pathlib import Path

import pytest

from ecu_emulator import cli as emulator
from tests.support.in_process import ended

FRAME = "(1767225600.{:06d}) can0 7AB#00\n"


@pytest.fixture(name="folder")
def _folder(drive_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "drive.log").write_bytes(drive_log.read_bytes())
    (tmp_path / "unknown.log").write_text("".join(map(FRAME.format, range(9))), encoding="ascii")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "words",
    [
        ("analyze", "drive.log", "-o", "out.csv"),
        ("analyze", "logs", "-o", "out.csv", "--jobs", "1"),
        ("decode", "drive.log", "-o", "out.csv"),
        ("calibrate", "drive.log", "-o", "out.csv"),
    ],
    ids=" ".join,
)
def test_the_service_asks_for_force(folder: Path, words: tuple[str, ...]) -> None:
    (folder / "out.csv").write_text("mine", encoding="ascii")
    (folder / "logs").mkdir()
    (folder / "logs" / "one.log").write_bytes((folder / "unknown.log").read_bytes())
    told = ended(*words)
    told.assert_one_line(2, "out.csv is there already; --force writes over it")
    assert (folder / "out.csv").read_text(encoding="ascii") == "mine"


@pytest.mark.parametrize(
    "words",
    [
        ("record", "mine.log", "--cycles", "1"),
        ("record", "new.log", "--truth", "mine.log"),
        ("run", "-i", "virtual", "-c", "x", "--truth", "mine.log"),
        ("dbc", "-o", "mine.log"),
    ],
    ids=" ".join,
)
def test_the_emulator_asks_for_force(folder: Path, words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "mine.log").write_text("mine", encoding="ascii")
    assert emulator.main(list(words)) == 2
    assert "mine.log is there already; --force writes over it\n" in capsys.readouterr().err
    assert (folder / "mine.log").read_text(encoding="ascii") == "mine"
    assert emulator.main(["dbc", "-o", "mine.log", "--force"]) == 0


@pytest.mark.parametrize(
    "words",
    [
        ("analyze", "cut.log", "--strict", "--store", "new.sqlite"),
        ("run", "-i", "socketcan", "-c", "nobus0", "--store", "new.sqlite"),
    ],
    ids=" ".join,
)
def test_a_run_that_fails_leaves_no_store(folder: Path, words: tuple[str, ...]) -> None:
    lines = (folder / "drive.log").read_bytes().splitlines(keepends=True)
    (folder / "cut.log").write_bytes(b"".join([*lines, b"what is this\n"]))
    told = ended(*words)
    assert told.status == 3, told.err
    assert [path.name for path in folder.iterdir() if "new.sqlite" in path.name] == []
