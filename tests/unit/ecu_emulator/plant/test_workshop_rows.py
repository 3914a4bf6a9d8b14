"""The workshop routine, row by row: what the revs show of the inertias, and that the cycles follow."""

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from ecu_emulator.plant import Col, DriveSettings, Powertrain, nominal_parameters
from ecu_emulator.shift_control import tcu_data
from ecu_emulator.truth import RevTruth, RevWatcher
from tests.support.cycles import CYCLE_SHIFTS, FloatArray, powertrain, shifts

ROUTINE = DriveSettings(open_revs=2, closed_revs=2)
LONGEST_S = 80.0
SIDE = nominal_calibration().input_side


@pytest.fixture(scope="module")
def train() -> Powertrain:
    return powertrain(ROUTINE, is_audited=True)


@pytest.fixture(scope="module")
def rows(train: Powertrain) -> FloatArray:
    driven = train.advance(LONGEST_S)
    driven.flags.writeable = False
    return driven


@pytest.fixture(scope="module")
def revs(rows: FloatArray) -> list[RevTruth]:
    return RevWatcher().feed(rows)


def stretch(rows: FloatArray, rev: RevTruth) -> FloatArray:
    return rows[round(1000 * rev.t_start_s) : round(1000 * rev.t_end_s)]


def integral(rows: FloatArray, rates: FloatArray) -> FloatArray:
    """Return the running integral of one value per row."""
    return np.concatenate(((0.0,), np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(rows[:, Col.T_S]))))


def test_the_revs_asked_for_are_performed(rows: FloatArray, revs: list[RevTruth]) -> None:
    assert [rev.are_clutches_closed for rev in revs] == [False, False, True, True]
    for rev in revs:
        speed_rad_s = stretch(rows, rev)[:, Col.ENGINE_SPEED]
        assert max(speed_rad_s[0], speed_rad_s[-1]) < 105.0
        assert 400.0 < speed_rad_s.max() < 425.0
        assert 1.8 < rev.t_end_s - rev.t_start_s < 2.6


def test_a_rev_is_in_neutral_and_the_car_at_rest(rows: FloatArray, revs: list[RevTruth]) -> None:
    for rev in revs:
        during = stretch(rows, rev)
        gears = during[:, [Col.CURRENT_GEAR, Col.TARGET_GEAR, Col.PRESELECTED_GEAR, Col.SHIFT_PHASE]]
        assert not gears.any()
        assert np.abs(during[:, [Col.VEHICLE_SPEED, Col.WHEEL_SPEED, Col.DIFF_SPEED]]).max() == 0.0


def test_the_pressures_are_those_of_the_part(rows: FloatArray, revs: list[RevTruth]) -> None:
    touch_pa = [clutch.touch_pressure_pa for clutch in nominal_calibration().clutches]
    for rev in revs:
        during = stretch(rows, rev)
        pressure_pa, is_stuck = during[:, [Col.PRESSURE1, Col.PRESSURE2]], during[:, [Col.STICK1, Col.STICK2]]
        if rev.are_clutches_closed:
            assert (pressure_pa > np.add(touch_pa, 1.0e5)).all()
            assert is_stuck.all()
        else:
            assert pressure_pa.max() == 0.0
            assert not is_stuck.any()


def test_with_open_clutches_the_torque_accelerates_engine_and_hub(rows: FloatArray, revs: list[RevTruth]) -> None:
    for rev in revs[:2]:
        during = stretch(rows, rev)
        drag_nm = during[:, [Col.CLUTCH1_TORQUE, Col.CLUTCH2_TORQUE]].sum(axis=1)
        assert np.array_equal(drag_nm, during[:, [Col.VISCOUS1_TORQUE, Col.VISCOUS2_TORQUE]].sum(axis=1))
        losses_nm = drag_nm + SIDE.hub_damping_nms_rad * during[:, Col.HUB_SPEED]
        impulse_nms = integral(during, during[:, Col.ENGINE_TORQUE] - losses_nm)
        momentum_nms = SIDE.engine_inertia_kg_m2 * during[:, Col.ENGINE_SPEED]
        momentum_nms = momentum_nms + SIDE.hub_inertia_kg_m2 * during[:, Col.HUB_SPEED]
        top = momentum_nms.argmax()
        gained_nms = momentum_nms - momentum_nms[0]
        assert impulse_nms[top] == pytest.approx(gained_nms[top], rel=1e-3)
        assert np.abs(impulse_nms - gained_nms).max() < 1e-3 * gained_nms[top]


def test_with_closed_clutches_it_accelerates_the_input_shafts_too(rows: FloatArray, revs: list[RevTruth]) -> None:
    for rev in revs[2:]:
        during = stretch(rows, rev)
        hub_rad_s = during[:, Col.HUB_SPEED]
        damping_nms_rad = SIDE.hub_damping_nms_rad + sum(SIDE.input_shaft_dampings_nms_rad)
        impulse_nms = integral(during, during[:, Col.ENGINE_TORQUE] - damping_nms_rad * hub_rad_s)
        behind_kg_m2 = SIDE.hub_inertia_kg_m2 + sum(SIDE.input_shaft_inertias_kg_m2)
        momentum_nms = SIDE.engine_inertia_kg_m2 * during[:, Col.ENGINE_SPEED] + behind_kg_m2 * hub_rad_s
        top = momentum_nms.argmax()
        gained_nms = momentum_nms - momentum_nms[0]
        assert impulse_nms[top] == pytest.approx(gained_nms[top], rel=1e-3)
        assert np.abs(impulse_nms - gained_nms).max() < 1e-3 * gained_nms[top]


def test_the_belief_about_the_input_shafts_is_true_of_the_nominal_plant() -> None:
    shafts = nominal_parameters().shafts
    inertias = [shaft.clutch_inertia_kg_m2 + shaft.gear_inertia_kg_m2 for shaft in shafts]
    dampings = [shaft.clutch_damping_nms_rad + shaft.gear_damping_nms_rad for shaft in shafts]
    assert pytest.approx(inertias) == SIDE.input_shaft_inertias_kg_m2
    assert pytest.approx(dampings) == SIDE.input_shaft_dampings_nms_rad


def test_after_the_routine_the_car_starts_and_drives_its_cycle(rows: FloatArray) -> None:
    assert shifts(rows) == [(0, 1), *CYCLE_SHIFTS]
    start = rows[rows[:, Col.ROUTINE] > tcu_data.CLOSED_REVS]
    assert start[0, Col.VEHICLE_SPEED] == 0.0
    assert 2.0 < start[-1, Col.VEHICLE_SPEED] < 4.0
    # From the driver's seat: no wheelspin, no stalled engine, no flare.
    assert start[:, Col.ENGINE_SPEED].min() > 60.0
    assert start[:, Col.ENGINE_SPEED].max() < 200.0
    assert np.abs(0.32 * start[:, Col.WHEEL_SPEED] - start[:, Col.VEHICLE_SPEED]).max() < 0.2
    launch = start[start[:, Col.CURRENT_GEAR] == 0]
    phases = launch[np.flatnonzero(np.diff(launch[:, Col.SHIFT_PHASE])) + 1, Col.SHIFT_PHASE]
    assert phases.tolist() == [tcu_data.PREFILL, tcu_data.INERTIA, tcu_data.LOCK_UP]


@pytest.mark.parametrize(("open_revs", "closed_revs"), [(1, 0), (0, 1)])
def test_either_part_can_be_left_out(open_revs: int, closed_revs: int) -> None:
    rows = powertrain(DriveSettings(open_revs=open_revs, closed_revs=closed_revs)).advance(12.0)
    assert [rev.are_clutches_closed for rev in RevWatcher().feed(rows)] == [False] * open_revs + [True] * closed_revs
    assert rows[-1, Col.CURRENT_GEAR] >= 1


@pytest.mark.parametrize("oil_k", [313.15, 403.15])
def test_cold_and_hot_oil_do_not_hold_the_routine_up(oil_k: float) -> None:
    rows = powertrain(DriveSettings(open_revs=1, closed_revs=1, initial_oil_k=oil_k)).advance(16.0)
    assert len(RevWatcher().feed(rows)) == 2
    assert rows[-1, Col.CURRENT_GEAR] >= 1


@pytest.mark.usefixtures("rows")
def test_energy_is_conserved_over_the_routine(train: Powertrain) -> None:
    assert train.finished
    assert abs(train.power_balance.residual_ratio) < 1e-3
    assert abs(train.power_balance.heat_residual_ratio) < 1e-3
