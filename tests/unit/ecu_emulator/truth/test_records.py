"""The truth of events: found as they happen, written and read back."""

import json
from pathlib import Path

import numpy as np
import pytest

from canlog.arrays import FloatArray
from ecu_emulator.driving.indices import ManoeuvreKind
from ecu_emulator.plant.state import Col
from ecu_emulator.shift_control.tcu_data import CLOSED_REVS, OPEN_REVS
from ecu_emulator.truth import (
    DriveTruth,
    EventTruth,
    EventWatcher,
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
        writer.write(DRIVE)
        writer.write(*shifts[:1])
        assert read_truth(path) == TruthLog(drive=DRIVE, shifts=shifts[:1], totals=None)
        writer.write(*shifts[1:])
        writer.write(rev)
        writer.write(totals)
    assert read_truth(path) == TruthLog(drive=DRIVE, shifts=shifts, totals=totals, revs=(rev,))


def test_a_file_from_before_there_were_events_is_read(tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    with TruthWriter(path) as writer:
        writer.write(DRIVE)
        writer.write(Totals(shifts=0, duration_s=9.0, frames=5))
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    del lines[0]["drive"], lines[1]["events"]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    assert read_truth(path) == TruthLog(drive=DRIVE, shifts=(), totals=Totals(shifts=0, duration_s=9.0, frames=5))


HUB_RAD_S = 150.0
TORQUE_NM = 100.0


def quiet_rows(count: int) -> FloatArray:
    """Return rows in 1st gear without an event: clutch 1 sticks, clutch 2 drags a little."""
    rows = made_up_rows(count)
    rows[:, [Col.HUB_SPEED, Col.INPUT1_SPEED]] = HUB_RAD_S
    rows[:, Col.INPUT2_SPEED] = 90.0
    rows[:, [Col.CLUTCH1_TORQUE, Col.CLUTCH2_TORQUE]] = (TORQUE_NM, 1.5)
    rows[:, [Col.VISCOUS1_TORQUE, Col.VISCOUS2_TORQUE]] = (0.0, 1.5)
    rows[:, [Col.STICK1, Col.STICK2]] = (1.0, 0.0)
    return rows


def with_event(rows: FloatArray, start: int, stop: int, kind: ManoeuvreKind, number: int = 1) -> FloatArray:
    changed = rows.copy()
    changed[start:stop, Col.EVENT_KIND] = kind
    changed[start:stop, Col.EVENT_NUMBER] = number
    return changed


def with_slip(rows: FloatArray, start: int, slip_rad_s: FloatArray, clutch: int = 1) -> FloatArray:
    changed = rows.copy()
    stop = start + len(slip_rad_s)
    changed[start:stop, Col.INPUT1_SPEED + clutch - 1] = HUB_RAD_S - slip_rad_s
    changed[start:stop, Col.CLUTCH1_TORQUE + clutch - 1] = TORQUE_NM
    changed[start:stop, Col.STICK1 + clutch - 1] = 0.0
    return changed


LAUNCH = with_event(
    with_slip(quiet_rows(3000), 500, np.linspace(100.0, 0.0, 1001)), 500, 1600, ManoeuvreKind.LAUNCH
)  # fmt: skip


def only(rows: FloatArray) -> EventTruth:
    (event,) = EventWatcher().feed(rows)
    return event


def test_a_launch_to_lock() -> None:
    event = only(LAUNCH)
    assert (event.number, event.event, event.clutch) == (1, "launch", 1)
    assert (event.t_start_s, event.t_end_s, event.from_gear, event.to_gear) == (0.5, 1.6, 1, 1)
    assert event.peak_slip_rad_s == 100.0
    assert event.slip_energy_j == pytest.approx(100.0 * 100.0 / 2.0, rel=2e-3)  # torque, half of the slip, 1 s
    assert (event.is_locked, event.is_aborted) == (True, False)
    assert event.reslip_rad_s == pytest.approx(0.9)  # the first millisecond below 1 rad/s
    assert event.mu_c == LAUNCH[1599, Col.MU_C1]
    assert event.mu_s == LAUNCH[1599, Col.MU_S1]
    assert event.clutch_temperature_k == LAUNCH[500, Col.CLUTCH1_TEMPERATURE]
    assert event.clutch_end_temperature_k == LAUNCH[1599, Col.CLUTCH1_TEMPERATURE]
    assert event.oil_temperature_k == LAUNCH[500, Col.SUMP_TEMPERATURE]


def test_a_shift_shows_the_clutch_that_did_more_work() -> None:
    rows = with_slip(with_slip(quiet_rows(1000), 100, np.full(50, 20.0)), 150, np.full(300, 60.0), clutch=2)
    rows = with_event(rows, 100, 500, ManoeuvreKind.POWER_ON_UPSHIFT)
    rows[:500, Col.CURRENT_GEAR], rows[500:, Col.CURRENT_GEAR] = 1.0, 2.0
    rows[500:, Col.STICK2] = 1.0
    event = only(rows)
    assert (event.event, event.from_gear, event.to_gear, event.clutch) == ("power_on_upshift", 1, 2, 2)
    assert (event.peak_slip_rad_s, event.is_locked) == (60.0, True)
    assert event.slip_energy_j == pytest.approx(TORQUE_NM * 60.0 * 0.3)
    assert event.other_slip_energy_j == pytest.approx(TORQUE_NM * 20.0 * 0.05)
    assert event.mu_c == rows[499, Col.MU_C2]


def test_an_event_cut_off_by_the_end_of_a_trip_is_told_once() -> None:
    watcher = EventWatcher()
    assert watcher.feed(LAUNCH[:1000]) == []
    (event,) = watcher.finish()
    assert (event.t_start_s, event.t_end_s) == (0.5, 0.999)
    assert watcher.finish() == []
    (following,) = watcher.feed(LAUNCH)
    assert following.number == 2
