"""A drive as GVRET with times that others write: below zero, in milliseconds; and times that no bus can have."""

import json
from pathlib import Path

import numpy as np
import pytest

from canlog.e2e.profile1 import protect
from canlog.frames import EXTENDED_FLAG, join
from canlog.logs import read_log
from tests.support.in_process import ended as run
from tests.support.service import Ended

FIRST_US = -3_000_000_000  # fifty minutes below zero


def written(drive_log: Path, path: Path, *, first_us: int, unit_us: int = 1) -> Path:
    """Write a drive as GVRET, its first frame at a time."""
    batch = join(list(read_log(drive_log)))
    times = (batch.t_ns - batch.t_ns[0]) // 1000 + first_us
    lines = [
        f"{time / unit_us:.0f},{can_id & ~EXTENDED_FLAG:08X},{str(can_id >= EXTENDED_FLAG).lower()},Rx,0,{length},"
        + ",".join(f"{byte:02X}" for byte in data[:length].tolist())
        for time, can_id, length, data in zip(
            times.tolist(), batch.can_id.tolist(), batch.length.tolist(), batch.data, strict=True
        )
    ]
    path.write_text("Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n" + "\n".join(lines) + "\n", "ascii")
    return path


def estimates(ended: Ended) -> list[float]:
    assert ended.status == 0, ended.err
    return [shift["friction"]["mu_c"] for shift in ended.shifts if shift["friction"] is not None]


@pytest.fixture
def usual(drive_log: Path, tmp_path: Path) -> Ended:
    log = written(drive_log, tmp_path / "usual.csv", first_us=1_000_000)
    return run("analyze", log, "--json")


def test_a_drive_below_zero_is_the_same_drive(drive_log: Path, tmp_path: Path, usual: Ended) -> None:
    log = written(drive_log, tmp_path / "below.csv", first_us=FIRST_US)
    reader = read_log(log)
    assert int(next(reader).t_ns[0]) == FIRST_US * 1000
    reader.close()
    ended = run("analyze", log, "--json")
    assert estimates(ended) == estimates(usual)
    assert len(estimates(ended)) >= 3
    across = written(drive_log, tmp_path / "across.csv", first_us=-20_000_000)
    assert estimates(run("analyze", across, "--json")) == estimates(usual)


def test_a_drive_in_milliseconds_is_read_and_said(drive_log: Path, tmp_path: Path, usual: Ended) -> None:
    log = written(drive_log, tmp_path / "ms.csv", first_us=1_000_000, unit_us=1_000)
    ended = run("analyze", log, "--json")
    assert f"{log}: times are taken as milliseconds, not microseconds" in ended.err
    assert len(estimates(ended)) == len(estimates(usual))
    assert np.allclose(estimates(ended), estimates(usual), rtol=0.05)
    shown = run("inspect", log, "--json")
    record = json.loads(shown.out)
    assert record["evidence"] == "line 1 is its header"
    assert "milliseconds" in record["notes"][0]
    assert record["bus_load_ratio"] < 1.0


def test_times_that_no_bus_can_have_are_said(tmp_path: Path) -> None:
    log = tmp_path / "fast.log"
    log.write_text("".join(f"(1700000000.{k:06d}) can0 123#0011223344556677 T\n" for k in range(100)), "ascii")
    ended = run("inspect", log)
    assert "taken for candump: 100 of the first 100 lines are frames in its grammar" in ended.out
    assert "the times cannot be right: the first 100 frames would load a bus of 1 Mbit/s by 11100 %" in ended.out
    assert "100 sent by the recorder" in ended.out
    log.write_text("(1700000000.000000) can0 123#0011223344556677\n" * 20, "ascii")
    assert "all have the same time" in run("inspect", log).out


def test_a_parked_car_loses_no_frames(tmp_path: Path) -> None:
    log, data = tmp_path / "parked.log", protect(np.zeros((40, 8), np.uint8), 41185, np.arange(40))
    lines = (f"({k * 0.01 + 600 * (k > 19):.6f}) can0 0A0#{row.tobytes().hex()}\n" for k, row in enumerate(data))
    log.write_text("".join(lines), "ascii")
    record = json.loads(run("inspect", log, "--json").out)
    assert record["protection"] == {"ECM_TorqueSpeed": {"good": 40, "errors": {}, "missing": 0}}
