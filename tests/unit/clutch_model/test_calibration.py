import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from clutch_model.calibration import Calibration, calibration_toml, nominal_calibration, read_calibration, shipped_table
from clutch_model.errors import CalibrationError


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("viscosity", "a_pa_s"), -1.0, "viscosity"),
        (("viscosity", "pole_k"), 300.0, "pole_k"),
        (("input_side", "engine_inertia_kg_m2"), 0.0, "engine_inertia_kg_m2"),
        (("input_side", "hub_inertia_kg_m2"), "0.04", "must be a number"),
        (("noise", "pressure_pa"), float("nan"), "finite"),
        (("noise", "pressure_pa"), 0.0, r"noise\.pressure_pa must be > 0"),
    ],
)
def test_a_number_outside_its_range_is_named(path: tuple[str, str], value: object, message: str) -> None:
    table = shipped_table()
    table[path[0]][path[1]] = value
    with pytest.raises(CalibrationError, match=message):
        Calibration.from_mapping(table)


@pytest.mark.parametrize("mu_s", [0.14, 0.15])
def test_friction_that_would_shudder_with_new_fluid_is_no_belief(mu_s: float, tmp_path: Path) -> None:
    path = tmp_path / "car.toml"
    path.write_text(f'like = "nominal"\n[[clutch]]\n[[clutch]]\nfriction.mu_s = {mu_s}\n', encoding="utf-8")
    with pytest.raises(CalibrationError, match=r"clutch 2 friction\.mu_s must be below mu_c"):
        read_calibration(path)
    table = shipped_table()
    table["clutch"][1]["friction"]["mu_s"] = mu_s
    assert Calibration.from_mapping(table).clutches[1].friction.mu_s == mu_s  # a car may be like that


def test_a_calibration_may_name_its_vehicle() -> None:
    named = Calibration.from_mapping(shipped_table() | {"vehicle": "car7"})
    assert (named.vehicle, nominal_calibration().vehicle) == ("car7", None)
    assert Calibration.from_mapping(tomllib.loads(calibration_toml(named))) == named


def test_a_file_may_be_like_a_shipped_calibration() -> None:
    table = {"like": "nominal", "name": "mine", "clutch": [{}, {"geometry": {"interface_count": 12}}]}
    found, nominal = Calibration.from_mapping(table), nominal_calibration()
    assert found.name == "mine"
    assert found.clutches[0] == nominal.clutches[0]
    assert found.clutches[1].geometry == replace(nominal.clutches[1].geometry, interface_count=12)
    assert found.clutches[1].friction == nominal.clutches[1].friction
    with pytest.raises(CalibrationError, match="no transmission 'dq500'; known: nominal, gs7"):
        Calibration.from_mapping({"like": "dq500"})


def test_the_clutches_of_older_files_have_the_names_of_their_transmission() -> None:
    shafts = {"gears": [], "elements": [{"name": "K1"}, {"name": "K2"}, {"name": "brake"}]}
    assert Calibration.from_mapping({"like": "nominal", "transmission": shafts}).elements == ("K1", "K2")
    assert Calibration.from_mapping({"like": "lockup"}).elements == ("lock-up clutch",)
