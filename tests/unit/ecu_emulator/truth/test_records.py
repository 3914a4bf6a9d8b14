import json
from pathlib import Path

import numpy as np
import pytest

from ecu_emulator.plant.state import Col
from ecu_emulator.shift_control.tcu_data import CLOSED_REVS, OPEN_REVS
from ecu_emulator.truth import (
    DriveTruth,
    FaultTruth,
    RevTruth,
    RevWatcher,
    ShiftWatcher,
    Totals,
    TruthLog,
    TruthWriter,
    read_truth,
    truth_path,
)
from tests.unit.ecu_emulator.rows import made_up_rows, with_revs, with_shift

DRIVE = DriveTruth(
    scenario="ideal",
    vehicle="car",
    seed=3,
    vehicle_seed=3,
    drive_seed=3,
    cycles=1,
    fluid="case1",
    mu_c=(0.13, 0.14),
    mu_s=(0.12, 0.11),
    drawn={"torque_gain_ratio": 1.01},
)
FAULT = FaultTruth(what="hub_speed_rad_s", kind="offset", size=2.0, t_start_s=0.2, t_end_s=None, count=4)
ROWS = with_shift(with_shift(made_up_rows(1200), 100, 500, 1, 2), 700, 1000, 2, 3)


def test_a_completed_shift_carries_the_truth_of_the_on_coming_clutch() -> None:
    upshift, next_upshift = ShiftWatcher().feed(ROWS)
    assert (upshift.number, upshift.from_gear, upshift.to_gear, upshift.clutch) == (1, 1, 2, 2)
    assert (upshift.t_start_s, upshift.t_end_s) == (0.1, 0.5)
    assert (upshift.mu_c, upshift.mu_s) == (ROWS[499, Col.MU_C2], ROWS[499, Col.MU_S2])
    assert upshift.clutch_temperature_k == pytest.approx(np.mean(ROWS[100:500, Col.CLUTCH2_TEMPERATURE]))
    assert (next_upshift.number, next_upshift.clutch) == (2, 1)
    assert next_upshift.mu_c == ROWS[999, Col.MU_C1]


def test_a_shift_that_goes_back_to_where_it_began_is_none() -> None:
    rows = made_up_rows(600)
    rows[100:300, Col.TARGET_GEAR] = 2.0
    assert ShiftWatcher().feed(rows) == []


def test_revs_are_told_apart_and_say_whether_the_clutches_are_closed() -> None:
    rows = with_revs(made_up_rows(1000), [(100, 200, OPEN_REVS), (200, 300, OPEN_REVS), (500, 700, CLOSED_REVS)])
    assert RevWatcher().feed(rows) == [
        RevTruth(number=1, t_start_s=0.1, t_end_s=0.2, are_clutches_closed=False),
        RevTruth(number=2, t_start_s=0.2, t_end_s=0.3, are_clutches_closed=False),
        RevTruth(number=3, t_start_s=0.5, t_end_s=0.7, are_clutches_closed=True),
    ]
    watcher = RevWatcher()
    assert [rev.number for rev in watcher.feed(rows[:600])] == [1, 2]
    assert [rev.number for rev in watcher.feed(rows[600:])] == [3]


def test_a_truth_file_reads_back(tmp_path: Path) -> None:
    path = truth_path(tmp_path / "drive.log")
    assert path.name == "drive.log.truth.jsonl"
    shifts = tuple(ShiftWatcher().feed(ROWS))
    rev = RevTruth(number=1, t_start_s=0.1, t_end_s=0.2, are_clutches_closed=True)
    totals = Totals(shifts=2, duration_s=1.2, frames=77, faults=(FAULT,))
    with TruthWriter(path) as writer:
        writer.drive(DRIVE)
        writer.write(shifts[:1])
        assert read_truth(path) == TruthLog(drive=DRIVE, shifts=shifts[:1], totals=None)
        writer.write(shifts[1:])
        writer.write([rev])
        writer.totals(totals)
    assert read_truth(path) == TruthLog(drive=DRIVE, shifts=shifts, totals=totals, revs=(rev,))


def test_a_file_from_before_there_were_events_is_read(tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    with TruthWriter(path) as writer:
        writer.drive(DRIVE)
        writer.totals(Totals(shifts=0, duration_s=9.0, frames=5))
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    del lines[0]["drive"], lines[1]["events"]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    assert read_truth(path) == TruthLog(drive=DRIVE, shifts=(), totals=Totals(shifts=0, duration_s=9.0, frames=5))
