from typing import cast

import pytest

from clutch_model.errors import CalibrationError
from ecu_emulator.plant.parameters import PlantParameters, plant_table


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


def test_unknown_and_missing_keys_are_named() -> None:
    with pytest.raises(CalibrationError, match=r"sump\.colour is unknown"):
        PlantParameters.from_mapping(changed("sump", "colour", 1.0))
    table = plant_table()
    del table["sump"]
    with pytest.raises(CalibrationError, match="sump is missing"):
        PlantParameters.from_mapping(table)
    table = plant_table()
    table["shaft"] = [{}]
    with pytest.raises(CalibrationError, match="exactly 2"):
        PlantParameters.from_mapping(table)
