"""Log files: what the emulator writes, and what the service and python-can read."""

from pathlib import Path

import can
import numpy as np
import pytest

from canlog.errors import SourceError
from canlog.logs import LogFormat, read_log
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.log_formats import open_log
from tests.support.traffic import START_NS, as_received, assert_same, random_frames

SUFFIXES = {LogFormat.CANDUMP: ".log", LogFormat.BLF: ".blf", LogFormat.MF4: ".mf4"}
FRAMES = random_frames(20_000)


def record(path: Path, frames: EncodedFrames = FRAMES, chunk: int = 7_001) -> Path:
    with open_log(path, start_ns=START_NS) as log:
        for first in range(0, len(frames), chunk):
            log.write(frames[first : first + chunk])
    return path


@pytest.fixture(params=SUFFIXES)
def log_format(request: pytest.FixtureRequest) -> LogFormat:
    return LogFormat(request.param)


def test_every_format_keeps_every_frame_to_the_microsecond(log_format: LogFormat, tmp_path: Path) -> None:
    reader = read_log(record(tmp_path / f"drive{SUFFIXES[log_format]}"))
    assert reader.format is log_format
    assert_same(list(reader), as_received(FRAMES))
    assert reader.counts.frames == len(FRAMES)
    assert not reader.counts.rejected
    assert not reader.counts.truncated


def test_python_can_reads_what_is_written(log_format: LogFormat, tmp_path: Path) -> None:
    path = record(tmp_path / f"drive{SUFFIXES[log_format]}")
    with can.LogReader(path, relative_timestamp=False) as reader:
        messages = list(reader)
    expected = as_received(FRAMES)
    t_us = np.rint(np.array([message.timestamp for message in messages]) * 1e6).astype(np.int64)
    assert np.array_equal(t_us * 1000, expected.t_ns)
    assert [bytes(message.data) for message in messages] == [
        data[:length].tobytes() for data, length in zip(FRAMES.data, FRAMES.length, strict=True)
    ]
    ids = [message.arbitration_id | (0x8000_0000 if message.is_extended_id else 0) for message in messages]
    assert np.array_equal(ids, FRAMES.can_id)


@pytest.mark.parametrize(
    ("contents", "text"),
    [
        (b"", "empty"),
        (b"\n \n", "empty"),
        (b"Time,Id,Data\n166064000,clutch,on\n", "a table with the columns Time, Id, Data; --columns"),
        (bytes(range(256)) * 400, "not a log of a known format"),
        (b"MDF     3.30    TGT 15.0", "before 4"),
        (b"MDF     4.10    ", "damaged"),
        (b"LOGG" + bytes(20), "header"),
        (b"LOGG" + bytes(300), "no CAN frame"),
        (b"date Thu Jan 01 10:00:00.500 2026\nbase hex  timestamps absolute\n", "no CAN frame"),
        (b"(1.0) can0 123##011223\n", "not a log of a known format"),
    ],
)
def test_a_file_without_frames_is_one_clear_line(contents: bytes, text: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    path.write_bytes(contents)
    with pytest.raises(SourceError, match=text) as caught:
        list(read_log(path))
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_an_interrupted_recording_leaves_nothing(log_format: LogFormat, tmp_path: Path) -> None:
    path = tmp_path / f"drive{SUFFIXES[log_format]}"

    def interrupted() -> None:
        with open_log(path) as log:
            log.write(FRAMES[:100])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not list(tmp_path.iterdir())
