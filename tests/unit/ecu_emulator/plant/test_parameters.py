from typing import cast

import pytest

from clutch_model.errors import CalibrationError, DomainError
from ecu_emulator.plant.course import as_record
from ecu_emulator.plant.parameters import PlantParameters, nominal_parameters, plant_table
from ecu_emulator.plant.powertrain import overall_ratios


def changed(section: str, key: str, value: object) -> dict[str, object]:
    table = plant_table()
    cast("dict[str, object]", table[section])[key] = value
    return table


def test_the_shipped_parameters_load() -> None:
    parameters = nominal_parameters()
    assert parameters.vehicle.mass_kg == 1700.0
    assert parameters.shafts[1].clutch_inertia_kg_m2 == 0.008
    assert overall_ratios(parameters.gearbox)[:2] == pytest.approx((0.0, 3.462 * 4.059))


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


def test_drag_may_be_absent() -> None:
    assert PlantParameters.from_mapping(changed("engine", "friction_nm", 0)).engine.friction_nm == 0.0


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


def test_a_record_reads_like_the_tuple_it_was_made_of() -> None:
    law = nominal_parameters().control
    record = as_record(law)
    assert record.dwell_s == law.dwell_s
    assert tuple(record.upshift_speeds_rad_s) == law.upshift_speeds_rad_s


def test_a_record_holds_numbers_only() -> None:
    with pytest.raises(DomainError, match="not part of a record"):
        as_record((1.0, "two"))
