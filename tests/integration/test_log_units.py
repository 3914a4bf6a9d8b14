"""A drive as GVRET with times that others write: below zero, in milliseconds; and times that no bus can have."""

import json
from pathlib import Path

import numpy as np
import pytest

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
