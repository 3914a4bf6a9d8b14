"""What the events of a drive look like: launches, creeps, every kind of change."""

import numpy as np

from canlog.arrays import FloatArray
from ecu_emulator.driving.indices import DrivelineState, ManoeuvreKind
from ecu_emulator.driving.journey import Car, DriveConditions, Trip
from ecu_emulator.plant.course import FrictionFactors
from ecu_emulator.plant.state import Col
from tests.unit.ecu_emulator.driving.drives import Event, driven, of_kind, trace

HOLD, PREFILL, TORQUE, INERTIA, LOCK_UP = range(5)


def only(rows: FloatArray, kind: ManoeuvreKind) -> Event:
    (event,) = of_kind(rows, kind)
    return event


def phases(event: Event) -> list[int]:
    phase = event.rows[:, Col.SHIFT_PHASE].astype(int)
    return [int(one) for one in phase[np.flatnonzero(np.diff(phase, prepend=-1))]]


def slip_rad_s(rows: FloatArray, clutch: int) -> FloatArray:
    return rows[:, Col.HUB_SPEED] - rows[:, Col.INPUT1_SPEED + clutch - 1]


def test_a_launch_slips_under_load_and_ends_locked(town: FloatArray) -> None:
    launch = only(town, ManoeuvreKind.LAUNCH)
    assert launch.gears == (1, 1)
    assert not launch.is_aborted
    assert phases(launch) == [HOLD]
    assert 2.0 < len(launch.rows) / 1000.0 < 5.0
    slip, torque_nm = slip_rad_s(launch.rows, 1), launch.rows[:, Col.CLUTCH1_TORQUE]
    assert slip.max() > 80.0
    assert abs(slip[-1]) < 1.0
    assert 40.0 < torque_nm[len(torque_nm) // 2] < 180.0
    heat_j = float((slip * torque_nm).sum() * 1.0e-3)
    assert 5.0e3 < heat_j < 2.5e4
    after = town[town[:, Col.T_S] > launch.rows[-1, Col.T_S]][100:1000]
    assert after[:, Col.STICK1].all()
    assert (after[:, Col.DRIVE_STATE] == DrivelineState.IN_GEAR).all()


def test_coast_downshifts_blip_the_throttle_and_slip_shortly(town: FloatArray) -> None:
    for event in of_kind(town, ManoeuvreKind.COAST_DOWNSHIFT):
        clutch = 2 - event.gears[1] % 2
        assert event.gears[1] == event.gears[0] - 1
        assert phases(event) == [PREFILL, INERTIA, LOCK_UP]
        assert event.rows[0, Col.ENGINE_TORQUE] < 10.0 < event.rows[:, Col.ENGINE_TORQUE].max()
        carried_nm = np.abs(event.rows[:, Col.CLUTCH1_TORQUE + clutch - 1])
        slipping = (np.abs(slip_rad_s(event.rows, clutch)) > 2.0) & (carried_nm > 6.0)
        assert slipping.sum() < 400
        assert abs(slip_rad_s(event.rows, clutch)[-1]) < 1.0


def test_in_a_kickdown_the_off_going_clutch_slips_first() -> None:
    rows = driven(trace((0, 0), (1, 0), (11, 15), (20, 15), (25, 32), (26, 32)))
    downshifts = of_kind(rows, ManoeuvreKind.KICKDOWN) + of_kind(rows, ManoeuvreKind.POWER_ON_DOWNSHIFT)
    strong = [event for event in downshifts if event.rows[:, Col.ENGINE_TORQUE].max() > 150.0]
    assert strong
    for event in strong:
        going, coming = 2 - event.gears[0] % 2, 2 - event.gears[1] % 2
        raising = event.rows[event.rows[:, Col.SHIFT_PHASE] == INERTIA]
        first = raising[: len(raising) // 2]
        assert slip_rad_s(first, going)[-1] > 5.0
        assert first[:, Col.CLUTCH1_TORQUE + going - 1].min() > 30.0
        assert np.abs(first[:, Col.CLUTCH1_TORQUE + coming - 1]).max() < 25.0
        assert abs(slip_rad_s(event.rows, coming)[-1]) < 1.0


def re_slip_rad_s(friction: FrictionFactors, launched_s: float) -> float:
    """Return the greatest slip of clutch 1 after it has locked for the first time in a launch to 14 m/s."""
    road = trace((0, 0), (1, 0), (1 + launched_s, 14), (2 + launched_s, 14))
    conditions = DriveConditions(whim_ratio=0.0, friction_factors=friction)
    rows = Trip(Car(), road, conditions, np.random.default_rng(1)).advance(6.5)
    slip = np.abs(slip_rad_s(rows, 1))
    slipping = int(np.argmax(slip > 50.0))
    locked = slipping + int(np.argmax(slip[slipping:] < 0.3))
    assert slip[locked] < 0.3
    return float(slip[locked : locked + 1200].max())


AGED = FrictionFactors(mu_c1=0.85, mu_s1=1.15, mu_c2=0.85, mu_s2=1.15)


def test_aged_fluid_sticks_and_slips_at_the_end_of_a_launch_the_more_the_greater_its_load() -> None:
    gentle, brisk, strong = (re_slip_rad_s(AGED, launched_s) for launched_s in (15.0, 9.0, 5.6))
    assert gentle < 5.0 < brisk < strong < 25.0
