"""The workshop routine, row by row: what the revs show of the inertias, and that the cycles follow."""

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from ecu_emulator.plant import Col, DriveSettings, Powertrain, nominal_parameters
from ecu_emulator.truth import RevTruth, RevWatcher
from tests.support.cycles import FloatArray, powertrain

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


@pytest.mark.usefixtures("rows")
def test_energy_is_conserved_over_the_routine(train: Powertrain) -> None:
    assert train.finished
    assert abs(train.power_balance.residual_ratio) < 1e-3
    assert abs(train.power_balance.heat_residual_ratio) < 1e-3
