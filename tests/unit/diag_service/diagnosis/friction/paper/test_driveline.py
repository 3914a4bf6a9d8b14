"""The service's driveline: that of the emulated vehicle, and checked when it is read."""

import tomllib
from collections.abc import Callable
from importlib.resources import files
from typing import Any

import pytest

from clutch_model.errors import CalibrationError
from diag_service.diagnosis.friction.paper import nominal_driveline
from diag_service.diagnosis.friction.paper.driveline import Driveline
from ecu_emulator.plant import nominal_parameters
from ecu_emulator.plant.powertrain import overall_ratios


def table() -> dict[str, Any]:
    text = files("diag_service").joinpath("diagnosis/friction/paper/driveline.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def test_the_nominal_driveline_is_that_of_the_emulated_vehicle() -> None:
    here, plant = nominal_driveline(), nominal_parameters()
    for shaft, emulated in zip(here.shafts, plant.shafts, strict=True):
        assert {name: getattr(shaft, name) for name in emulated._fields} == emulated._asdict()
    assert (here.flywheel.stiffness_nm_rad, here.flywheel.damping_nms_rad) == tuple(plant.flywheel)
    assert here.overall_ratios == overall_ratios(plant.gearbox)[1:]
    assert here.output.inertia_kg_m2 == plant.output.inertia_kg_m2
    assert here.output.stiffness_nm_rad == plant.output.stiffness_nm_rad
    assert here.output.damping_nms_rad == plant.output.shaft_damping_nms_rad
    assert here.wheel.radius_m == plant.vehicle.wheel_radius_m


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda whole: whole.pop("wheel"), "wheel is missing"),
        (lambda whole: whole["flywheel"].update(stiffness_nm_rad=0.0), "flywheel.stiffness_nm_rad must be > 0"),
        (lambda whole: whole["shaft"].pop(), "exactly 2"),
        (lambda whole: whole["shaft"][1].update(extra=1.0), r"shaft 2\.extra is unknown"),
        (lambda whole: whole["wheel"].update(radius_m=-0.3), "wheel.radius_m must be > 0"),
        (lambda whole: whole["gearbox"].update(gear_ratios=[3.0]), "gear_ratios"),
    ],
)
def test_a_spoilt_driveline_is_refused(spoil: Callable[[dict[str, Any]], None], text: str) -> None:
    whole = table()
    spoil(whole)
    with pytest.raises(CalibrationError, match=text):
        Driveline.from_mapping(whole)
