"""A log on standard input is what it is in a file, to the bit; it is read as it comes, and left when one is told to."""

import gzip
import json
import os
import pty
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from canlog.errors import InputLeftError, SourceError
from canlog.files import WIDE_BYTES
from canlog.frames import FrameBatch, join
from canlog.logs import STANDARD_INPUT, read_log
from diag_service.errors import ConfigError
from diag_service.service.drive import open_drive
from diag_service.service.stopping import Trigger
from ecu_emulator import cli as emulator
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.log_formats.record import LogFormat, open_log
from tests.support.in_process import ended
from tests.support.patience import HANG_S
from tests.support.pipes import pieces_of, piped
from tests.support.service import PROGRAM, environment

ODD_SIZES = [1, 2, 44, 45, 46, 4096, 65_536, 70_001, 3, 200_000]
FORMATS = ["blf", "asc", "trc", "csv", "gvret"]
Record = dict[str, Any]


def without(records: list[Record], *keys: str) -> list[Record]:
    """Return records without what names the log."""
    return [{key: value for key, value in record.items() if key not in keys} for record in records]


def test_a_pipe_gives_the_results_of_the_file_to_the_bit(drive_log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = ended("analyze", drive_log, "--json")
    with piped(monkeypatch, pieces_of(drive_log.read_bytes(), ODD_SIZES)):
        pipe = ended("analyze", "-", "--json")
    assert (pipe.status, len(pipe.shifts)) == (0, 3)
    assert without(pipe.shifts, "stream") == without(file.shifts, "stream")
    summaries = json.dumps(file.summary).replace(str(drive_log), "-"), json.dumps(pipe.summary)
    streams = [json.loads(text)["clutches"] for text in summaries]
    assert without(streams[0], "stream") == without(streams[1], "stream")
    assert without([json.loads(summaries[0])], "clutches") == without([json.loads(summaries[1])], "clutches")


WATCH = """
import fcntl, sys

class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy":
            sys.exit(str(fcntl.fcntl(0, fcntl.F_GETPIPE_SZ)))

sys.meta_path.insert(0, Watch())
from diag_service.cli import main

main(["analyze", "-"])
"""


def test_a_pipe_is_wide_before_libraries_are_loaded() -> None:
    """Loading them takes seconds on a small machine, in which candump must find room or lose frames."""
    done = subprocess.run([sys.executable, "-c", WATCH], input=b"", capture_output=True, check=False, timeout=HANG_S)
    assert done.stderr.decode() == f"{WIDE_BYTES}\n"


def test_every_run_over_a_pipe_is_a_stream_of_its_own(drive_log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = drive_log.read_bytes()
    names = set()
    for _ in range(2):
        with piped(monkeypatch, [content]):
            names |= {shift["stream"] for shift in ended("analyze", "-", "--json").shifts}
    assert len(names) == 2


def written(path: Path, log_format: str, frames: FrameBatch) -> None:
    """Write frames as a log."""
    start_ns = int(frames.t_ns[0])
    encoded = EncodedFrames(
        t_s=(frames.t_ns - start_ns) / 1e9, can_id=frames.can_id, length=frames.length, data=frames.data
    )
    with open_log(path, log_format=LogFormat(log_format), start_ns=start_ns) as log:
        log.write(encoded)


@pytest.mark.parametrize("log_format", [*FORMATS, "gz"])
def test_every_format_comes_through_a_pipe(
    log_format: str, drive_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = drive_log.read_bytes().splitlines(keepends=True)[:3_000]
    path = tmp_path / f"drive.{log_format}"
    if log_format == "gz":
        path.write_bytes(gzip.compress(b"".join(lines)))
    else:
        written(path, log_format, join(list(read_log(drive_log)))[:3_000])
    file = read_log(path)
    wanted = join(list(file))
    with piped(monkeypatch, pieces_of(path.read_bytes(), [5, 100, 4096])):
        reader = read_log("-")
        found = join(list(reader))
    assert (reader.format, reader.counts) == (file.format, file.counts)
    for name in ("t_ns", "can_id", "length", "data", "channel", "flags"):
        assert (getattr(found, name) == getattr(wanted, name)).all(), name


def test_frames_are_handed_over_while_the_writer_waits(drive_log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = drive_log.read_bytes().splitlines(keepends=True)[:200]
    went_on = threading.Event()

    def wait() -> None:
        assert went_on.wait(HANG_S)

    with piped(monkeypatch, [b"".join(lines[:150]), wait, b"".join(lines[150:])]):
        reader = read_log("-")
        first = next(reader)  # though nothing more comes before it is there
        went_on.set()
        rest = join([first, *reader])
    assert (len(first), len(rest)) == (150, 200)


def test_a_pipe_that_nobody_ends_is_left_when_one_is_told_to(drive_log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = drive_log.read_bytes().splitlines(keepends=True)[:200]
    stop, left = Trigger(), threading.Event()
    with piped(monkeypatch, [b"".join(lines), lambda: left.wait(HANG_S)]):
        reader = read_log("-", is_stopped=lambda: stop.is_set)
        assert len(next(reader)) == 200
        stop.set()
        with pytest.raises(InputLeftError, match="stopped early: standard input was left before its end"):
            next(reader)
        left.set()


def test_ctrl_c_without_an_end_of_the_stream_ends_early(drive_log: Path) -> None:
    with subprocess.Popen(
        [*PROGRAM, "analyze", "-"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env=environment(),
    ) as running:  # fmt: skip
        assert running.stdin is not None
        assert running.stdout is not None
        assert running.stderr is not None
        running.stdin.write(drive_log.read_bytes())
        running.stdin.flush()
        told = running.stdout.readline() + running.stdout.readline()  # the head and a shift: it is at work
        running.send_signal(signal.SIGINT)
        told += running.stdout.read()
        said = running.stderr.read()
        status = running.wait(HANG_S)
        running.stdin.close()
    assert (status, b"stopped early" in said) == (130, True)
    assert b"only a part of the drive was read, which gets no verdict" in told


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "standard input: the file is empty"),
        (b"nothing of a log\n" * 20, "standard input: not a log of a known format"),
        (b"Day,Tyre,Bar\n1,left,2.2\n" * 20, "standard input: .* the columns Day, Tyre, Bar; --columns"),
    ],
)
def test_what_is_no_log_is_told(content: bytes, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with piped(monkeypatch, [content]), pytest.raises(SourceError, match=text):
        read_log("-")


def test_a_terminal_or_nothing_is_no_log(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    with os.fdopen(theirs) as terminal, os.fdopen(ours, "wb"):
        monkeypatch.setattr("sys.stdin", terminal)
        with pytest.raises(SourceError, match="standard input: it is a terminal; pipe a log into it"):
            read_log("-")
    monkeypatch.setattr("sys.stdin", None)
    with pytest.raises(SourceError, match="standard input: it is closed"):
        read_log("-")
    with (
        pytest.raises(ConfigError, match="standard input is given twice"),
        open_drive([STANDARD_INPUT, STANDARD_INPUT]),
    ):
        pass


def test_a_file_may_be_called_so(drive_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "-").write_bytes(b"".join(drive_log.read_bytes().splitlines(keepends=True)[:300]))
    monkeypatch.chdir(tmp_path)
    assert "300 frames" in ended("inspect", "./-").out


@pytest.mark.parametrize("words", [["--format", "blf"], ["--format", "mf4"], ["--json"]])
def test_what_cannot_go_to_standard_output_is_told(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert emulator.main(["record", "-", *words]) in {2, 4}
    assert capsys.readouterr().err.count("\n") == 1


def test_the_emulator_records_into_a_pipe(tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    words = ["--scenario", "noise_only", "--cycles", "1"]
    assert emulator.main(["record", str(tmp_path / "drive.log"), *words]) == 0
    capfdbinary.readouterr()
    assert emulator.main(["record", "-", *words, "--truth", str(tmp_path / "t.jsonl")]) == 0
    out, err = capfdbinary.readouterr()
    assert out == (tmp_path / "drive.log").read_bytes()
    assert (tmp_path / "t.jsonl").read_bytes() == (tmp_path / "drive.log.truth.jsonl").read_bytes()
    assert b"standard output: " in err
