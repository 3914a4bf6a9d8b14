"""An automatic behind a torque converter: its energy, its steps, its lock-up clutch, and when that one shudders."""

from dataclasses import replace

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration, shipped_calibration
from ecu_emulator.drive.build import FLUID_FACTORS
from ecu_emulator.driving.indices import LockUpState
from ecu_emulator.driving.journey import Car, Trip
from ecu_emulator.plant.parameters import nominal_parameters
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario.scenario import FluidCondition
from ecu_emulator.truth import SHUDDER_HZ, ShudderTruth, ShudderWatcher
from tests.support.power_balance import power_balance
from tests.unit.ecu_emulator.driving.drives import WARM_K, conditions, trace

COUNTRY = trace((0, 0), (2, 0), (14, 16), (30, 22), (44, 26), (50, 26), (58, 14), (66, 0), (68, 0))
OUTWARD_S = 50.0


def with_fluid(fluid: FluidCondition) -> Calibration:
    calibration, (by_c, by_s) = shipped_calibration("lockup"), FLUID_FACTORS[fluid]
    clutch = calibration.clutches[0]
    friction = replace(clutch.friction, mu_c=by_c * clutch.friction.mu_c, mu_s=by_s * clutch.friction.mu_s)
    return replace(calibration, clutches=(replace(clutch, friction=friction),) * 2)


def trip(fluid: FluidCondition = FluidCondition.IDEAL, *, is_audited: bool = False, **changes: float) -> Trip:
    car = Car(truth=with_fluid(fluid), parameters=nominal_parameters("lockup"))
    whole = Trip(car, COUNTRY, conditions(**changes), np.random.default_rng(1))
    if is_audited:
        whole.audit()
    return whole


@pytest.fixture(scope="module")
def audited() -> tuple[Trip, FloatArray]:
    whole = trip(is_audited=True)
    return whole, whole.advance(COUNTRY.duration_s)


def shudders(rows: FloatArray) -> list[ShudderTruth]:
    watcher = ShudderWatcher()
    return [*watcher.feed(rows), *watcher.finish()]


def slip_rad_s(rows: FloatArray) -> FloatArray:
    return rows[:, Col.ENGINE_SPEED] - rows[:, Col.TURBINE_SPEED]


def test_no_energy_appears_or_gets_lost(audited: tuple[Trip, FloatArray]) -> None:
    balance = power_balance(audited[0])
    assert abs(balance.residual_ratio) < 1e-6
    assert abs(balance.heat_residual_ratio) < 1e-6
    assert balance.converter_j > balance.clutch_j > 0.0


def test_the_lock_up_clutch_slips_a_little_pulling_and_not_at_all_coasting(audited: tuple[Trip, FloatArray]) -> None:
    rows = audited[1]
    state, slip = rows[:, Col.LOCKUP_STATE], slip_rad_s(rows)
    is_slipping, is_locked = state == LockUpState.SLIPPING, state == LockUpState.LOCKED
    assert is_slipping.mean() > 0.15
    assert np.quantile(slip[is_slipping], 0.1) > 1.5
    assert np.quantile(slip[is_slipping], 0.9) < 9.0
    is_coasting = is_locked & (rows[:, Col.ENGINE_TORQUE] < -20.0)
    assert is_coasting.sum() > 1000
    assert np.median(np.abs(slip[is_coasting])) < 0.5
    is_closed = (state == LockUpState.APPLYING) | is_slipping | is_locked
    assert rows[is_closed, Col.CURRENT_GEAR].min() >= 3


@pytest.mark.parametrize("fluid", [FluidCondition.IDEAL, FluidCondition.CASE_1])
@pytest.mark.parametrize("oil_k", [318.15, WARM_K, 383.15])
def test_friction_that_rises_with_the_slip_never_shudders(fluid: FluidCondition, oil_k: float) -> None:
    assert not shudders(trip(fluid, oil_k=oil_k).advance(OUTWARD_S))


def test_friction_that_falls_with_the_slip_shudders_at_the_frequency_of_the_driveline() -> None:
    found = shudders(trip(FluidCondition.CASE_2).advance(OUTWARD_S))
    assert sum(one.t_end_s - one.t_start_s for one in found) > 3.0
    assert all(SHUDDER_HZ[0] < one.frequency_hz < 16.0 for one in found)
    assert max(one.amplitude_rad_s for one in found) > 3.0
