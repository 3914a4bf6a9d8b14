"""Nothing is written over a file unless that is asked for, and a run that fails leaves no store behind."""

import os
from pathlib import Path

import pytest

from diag_service.errors import StoreError
from ecu_emulator import cli as emulator
from ecu_emulator.errors import BusError
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


def test_force_writes_over_it_and_shows_the_table_too(folder: Path) -> None:
    (folder / "out.jsonl").write_text("mine", encoding="ascii")
    plain = ended("analyze", "drive.log")
    told = ended("analyze", "drive.log", "-o", "out.jsonl", "--force")
    assert (told.status, told.out) == (0, plain.out)
    assert "3 shifts of 1 drives in out.jsonl" in told.err
    assert (folder / "out.jsonl").read_text(encoding="utf-8").count("\n") == 4


@pytest.mark.parametrize(
    "words",
    [
        ("record", "mine.log", "--cycles", "1"),
        ("record", "new.log", "--truth", "mine.log"),
        ("run", "-i", "virtual", "-c", "x", "--truth", "mine.log"),
        ("run", "-i", "virtual", "-c", "x", "--summary", "mine.log"),
        ("pdx", "-o", "mine.log"),
    ],
    ids=" ".join,
)
def test_the_emulator_asks_for_force(folder: Path, words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "mine.log").write_text("mine", encoding="ascii")
    assert emulator.main(list(words)) == 2
    assert "mine.log is there already; --force writes over it\n" in capsys.readouterr().err
    assert (folder / "mine.log").read_text(encoding="ascii") == "mine"
    assert emulator.main(["pdx", "-o", "mine.log", "--force"]) == 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--workshop",), "--diagnostics is needed"),
        (("--diagnostics", "mine.json"), "mine.json"),
        (("--diagnostics", "--diagnostic-memory", "mine.json"), "mine.json is damaged"),
        (("--control", "mine.json"), "there is a file"),
        (("--diagnostics", "--diagnostic-memory", "mine.jsonl"), "two outputs cannot both be"),
        (("--alive", "mine.jsonl"), "two outputs cannot both be"),
    ],
)
def test_a_drive_that_does_not_begin_writes_nothing_over(
    folder: Path, words: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("mine.jsonl", "mine.json"):
        (folder / name).write_text("mine", encoding="ascii")
    run = ("run", "-i", "virtual", "-c", "x", "--truth", "mine.jsonl", "--summary", "new.json", "--force", *words)
    assert emulator.main(run) != 0
    assert told in capsys.readouterr().err
    assert {(folder / name).read_text(encoding="ascii") for name in ("mine.jsonl", "mine.json")} == {"mine"}
    assert not (folder / "new.json").exists()


def test_a_drive_that_has_begun_has_no_summary_of_another(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*_: object, **__: object) -> None:
        raise BusError("the bus went away")

    monkeypatch.setattr("ecu_emulator.live.live_drive.transmit", gone)
    (folder / "old.json").write_text("mine", encoding="ascii")
    assert emulator.main(["run", "-i", "virtual", "-c", "x", "--summary", "old.json", "--force"]) == 3
    assert (folder / "old.json").read_text(encoding="ascii") == "{}\n"


@pytest.mark.parametrize("command", ["analyze", "decode", "calibrate"])
def test_a_device_or_pipe_is_not_replaced_by_a_file(folder: Path, command: str) -> None:
    os.mkfifo(folder / "pipe.csv")
    told = ended(command, "drive.log", "-o", "pipe.csv", "--force")
    told.assert_one_line(2, "pipe.csv is not a plain file")
    assert (folder / "pipe.csv").is_fifo()


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


def test_a_store_that_was_there_stays(folder: Path) -> None:
    assert ended("analyze", "drive.log", "--store", "old.sqlite").status == 0
    size = (folder / "old.sqlite").stat().st_size
    assert ended("run", "-i", "socketcan", "-c", "nobus0", "--store", "old.sqlite").status == 3
    assert (folder / "old.sqlite").stat().st_size == size


def test_results_of_a_full_disk_are_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from diag_service.store import ResultStore  # noqa: PLC0415 - what is patched

    add, added = ResultStore.add, list[object]()

    def once(store: ResultStore, *words: object) -> bool:
        if added:
            raise StoreError("the disk is full")
        added.append(words)
        return add(store, *words)  # type: ignore[arg-type]  # handed on as they came

    monkeypatch.setattr(ResultStore, "add", once)
    assert ended("analyze", "drive.log", "--store", "part.sqlite").status == 4
    assert (folder / "part.sqlite").exists()


def test_what_is_not_known_is_answered_by_what_to_try(folder: Path) -> None:
    tries = {
        ("analyze", "unknown.log"): (0, "try 'diag-service signals LOG', with --dbc FILE for frames"),
        ("decode", "unknown.log", "-o", "out.csv"): (2, "Try diag-service signals LOG --dbc FILE"),
    }
    for words, (status, text) in tries.items():
        told = ended(*words)
        assert told.status == status
        assert text in told.out + told.err
