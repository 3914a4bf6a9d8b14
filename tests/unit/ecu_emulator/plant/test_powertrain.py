"""The plant: its parameters, its drives and its energy."""

from dataclasses import fields, replace
from typing import cast

import numpy as np
import pytest

from clutch_model.errors import CalibrationError
from ecu_emulator.plant.course import DriveSettings, FrictionFactors, cycle_table
from ecu_emulator.plant.parameters import PlantParameters, nominal_parameters, plant_table
from ecu_emulator.plant.powertrain import Powertrain
from ecu_emulator.plant.state import Col
from ecu_emulator.shift_control import tcu_data
from tests.support.cycles import CYCLE_SHIFTS, FloatArray
from tests.support.power_balance import power_balance


@pytest.fixture(scope="module")
def rows(driven_cycle: tuple[Powertrain, FloatArray]) -> FloatArray:
    _, rows = driven_cycle
    return rows


def test_the_target_leads_the_current_gear_through_a_shift(rows: FloatArray) -> None:
    is_shifting = rows[:, Col.TARGET_GEAR] != rows[:, Col.CURRENT_GEAR]
    assert np.array_equal(is_shifting, rows[:, Col.SHIFT_PHASE] > 0)
    assert (rows[is_shifting, Col.PRESELECTED_GEAR] == rows[is_shifting, Col.TARGET_GEAR]).all()
    phases = rows[np.flatnonzero(np.diff(rows[:, Col.SHIFT_PHASE])) + 1, Col.SHIFT_PHASE]
    assert phases.tolist() == [1, 2, 3, 4, 0] * len(CYCLE_SHIFTS)


CONTROL = nominal_parameters().control


@pytest.mark.parametrize(
    ("name", "value"), [("seed", -1), ("vary_ratio", 0.5), ("dt_s", 1e-3), ("dt_s", 1.5e-4), ("dt_s", float("nan"))]
)
def test_a_setting_outside_its_range_is_named(name: str, value: object) -> None:
    assert name in {field.name for field in fields(DriveSettings)}
    with pytest.raises(CalibrationError, match=name):
        replace(DriveSettings(), **{name: value})  # type: ignore[arg-type]  # wrong on purpose


def test_cycles_vary_with_the_seed_and_a_longer_drive_begins_alike() -> None:
    short = cycle_table(DriveSettings(cycles=2, seed=4, vary_ratio=0.05), CONTROL)
    long = cycle_table(DriveSettings(cycles=5, seed=4, vary_ratio=0.05), CONTROL)
    other = cycle_table(DriveSettings(cycles=2, seed=5, vary_ratio=0.05), CONTROL)
    assert np.array_equal(long[:2], short)
    assert not np.isclose(short[:, : tcu_data.CYCLE_MU], other[:, : tcu_data.CYCLE_MU]).any()


def test_friction_factors_go_cycle_by_cycle_and_the_last_one_goes_on() -> None:
    aged = FrictionFactors(mu_c1=0.9, mu_s1=1.1, mu_c2=0.8, mu_s2=1.2)
    table = cycle_table(DriveSettings(cycles=3, friction_factors=(FrictionFactors(), aged)), CONTROL)
    found = table[:, tcu_data.CYCLE_MU : tcu_data.CYCLE_UP].tolist()
    assert found == [[1.0, 1.0, 1.0, 1.0], [0.9, 1.1, 0.8, 1.2], [0.9, 1.1, 0.8, 1.2]]


def test_energy_is_conserved_over_a_cycle(driven_cycle: tuple[Powertrain, FloatArray]) -> None:
    train, _ = driven_cycle
    balance = power_balance(train)
    assert abs(balance.residual_ratio) < 1e-3
    assert abs(balance.heat_residual_ratio) < 1e-3
    # The books hold something: the engine drove the car, brakes and road stopped it, the clutches slipped.
    assert balance.engine_j > 5.0e5
    assert balance.brake_j > 1.0e5
    assert balance.clutch_j > 1.0e4
    assert min(balance.bearing_j, balance.damper_j, balance.gear_j, balance.synchroniser_j, balance.tyre_j) > 0.0


def changed(section: str, key: str, value: object) -> dict[str, object]:
    table = plant_table()
    cast("dict[str, object]", table[section])[key] = value
    return table


@pytest.mark.parametrize(
    ("section", "key", "value", "message"),
    [
        ("vehicle", "mass_kg", 0.0, r"vehicle\.mass_kg must be > 0"),
        ("vehicle", "mass_kg", "heavy", r"vehicle\.mass_kg must be a number"),
        ("synchroniser", "efficiency_ratio", 1.01, r"synchroniser\.efficiency_ratio must be <= 1"),
        ("engine", "closed_throttle_rad", 2.0, "closed_throttle_rad"),
        ("engine", "friction_nm", float("nan"), r"engine\.friction_nm must be finite"),
        ("gearbox", "gear_ratios", [1.0, 2.0], r"gearbox\.gear_ratios: 6 to 9 numbers"),
        ("control", "upshift_speeds_rad_s", [1.0] * 6, r"upshift_speeds_rad_s must be a list of 5 numbers"),
    ],
)
def test_a_number_outside_its_range_is_named(section: str, key: str, value: object, message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        PlantParameters.from_mapping(changed(section, key, value))
