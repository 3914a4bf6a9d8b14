from dataclasses import fields, replace

import numpy as np
import pytest

from clutch_model.errors import CalibrationError
from ecu_emulator.plant.drive import DriveSettings, FrictionFactors, cycle_table
from ecu_emulator.plant.parameters import nominal_parameters
from ecu_emulator.shift_control import tcu_data

CONTROL = nominal_parameters().control


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cycles", 0),
        ("seed", -1),
        ("pedal_ratio", 0.1),
        ("vary_ratio", 0.5),
        ("initial_oil_k", 273.15),
        ("open_revs", 21),
        ("dt_s", 1e-3),
        ("dt_s", 1.5e-4),
        ("dt_s", float("nan")),
        ("friction_factors", (FrictionFactors(mu_c1=0.0),)),
    ],
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
    assert found == [
        [1.0, 1.0, 1.0, 1.0],
        [0.9, 1.1, 0.8, 1.2],
        [0.9, 1.1, 0.8, 1.2],
    ]
