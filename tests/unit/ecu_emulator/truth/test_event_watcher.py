"""Events are found in plant rows with what only the plant knows of them."""

import numpy as np
import pytest

from canlog.arrays import FloatArray
from ecu_emulator.driving.indices import EventKind
from ecu_emulator.plant.state import Col
from ecu_emulator.truth import EventTruth, EventWatcher
from tests.unit.ecu_emulator.rows import made_up_rows

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


def with_event(rows: FloatArray, start: int, stop: int, kind: EventKind, number: int = 1) -> FloatArray:
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
    with_slip(quiet_rows(3000), 500, np.linspace(100.0, 0.0, 1001)), 500, 1600, EventKind.LAUNCH
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
    rows = with_event(rows, 100, 500, EventKind.POWER_ON_UPSHIFT)
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
