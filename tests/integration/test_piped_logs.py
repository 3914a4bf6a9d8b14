"""A log on standard input is what it is in a file, to the bit; it is read as it comes, and left when one is told to."""

import gzip
import json
import signal
import subprocess
import threading
from pathlib import Path
from typing import Any

import pytest

from canlog.frames import FrameBatch, join
from canlog.logs import read_log
from canlog.time_order import LATE_NS
from ecu_emulator import cli as emulator
from tests.support.in_process import ended
from tests.support.log_grammars import GRAMMARS, Frame
from tests.support.patience import HANG_S
from tests.support.pipes import pieces_of, piped
from tests.support.service import PROGRAM, environment

ODD_SIZES = [1, 2, 44, 45, 46, 4096, 65_536, 70_001, 3, 200_000]
FORMATS = ["blf", "asc", "trc 2.1", "csv", "gvret"]
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


def written(path: Path, log_format: str, frames: FrameBatch) -> None:
    """Write frames as a log."""
    columns = zip(frames.t_ns.tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data, strict=True)
    start_ns = int(frames.t_ns[0])
    GRAMMARS[log_format].write(path, [
        Frame(t_us=(t_ns - start_ns) // 1000, can_id=can_id, is_extended=False, length=length, data=data.tobytes())
        for t_ns, can_id, length, data in columns
    ])  # fmt: skip


@pytest.mark.parametrize("log_format", [*FORMATS, "gz"])
def test_every_format_comes_through_a_pipe(
    log_format: str, drive_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = drive_log.read_bytes().splitlines(keepends=True)[:3_000]
    path = tmp_path / "drive"
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
        first = next(reader)  # though nothing more comes before it is there; a late frame may belong into what is held
        went_on.set()
        rest = join([first, *reader])
    written_us = [int(line[1 : line.index(b")")].replace(b".", b"")) for line in lines[:150]]
    assert len(first) == sum(at_us < written_us[-1] - LATE_NS // 1_000 for at_us in written_us) > 0
    assert len(rest) == 200


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


def test_the_emulator_records_into_a_pipe(tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    words = ["--scenario", "noise_only", "--cycles", "1"]
    assert emulator.main(["record", str(tmp_path / "drive.log"), *words]) == 0
    capfdbinary.readouterr()
    assert emulator.main(["record", "-", *words, "--truth", str(tmp_path / "t.jsonl")]) == 0
    out, err = capfdbinary.readouterr()
    assert out == (tmp_path / "drive.log").read_bytes()
    assert (tmp_path / "t.jsonl").read_bytes() == (tmp_path / "drive.log.truth.jsonl").read_bytes()
    assert b"standard output: " in err
