"""Effects that the service's model lacks: each changes what it should and nothing else."""

from dataclasses import fields, replace

import pytest

from clutch_model.calibration import nominal_calibration
from ecu_emulator.drive.build import BuiltVehicle, build_vehicle
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.plant.parameters import PlantParameters, nominal_parameters
from ecu_emulator.scenario.scenario import Effects, Scenario
from tests.support.builders import drive_scenario

NOMINAL = nominal_calibration()
PARAMETERS = nominal_parameters()


def scenario_with(**effects: float) -> Scenario:
    return replace(drive_scenario(), effects=Effects(**effects))  # type: ignore[arg-type]  # one of them is a flag


def vehicle_with(**effects: float) -> BuiltVehicle:
    return build_vehicle(scenario_with(**effects))


@pytest.mark.parametrize(
    ("effect", "value", "place", "ratio"),
    [
        ("stribeck_speed_ratio", 1.5, "friction.stribeck_speed_rad_s", 1.5),
        ("contact_stiffness_ratio", 0.5, "film.contact_stiffness_pa", 0.5),
        ("piston_area_ratio", 1.01, "geometry.piston_area_m2", 1.01),
    ],
)
def test_an_effect_on_the_clutch_changes_its_number_only(effect: str, value: float, place: str, ratio: float) -> None:
    vehicle, (part, name) = vehicle_with(**{effect: value}), place.split(".")
    for changed, nominal in zip(vehicle.calibration.clutches, NOMINAL.clutches, strict=True):
        before, after = getattr(nominal, part), getattr(changed, part)
        assert getattr(after, name) == pytest.approx(ratio * getattr(before, name))
        assert replace(changed, **{part: replace(after, **{name: getattr(before, name)})}) == nominal
    assert vehicle.parameters == PARAMETERS


@pytest.mark.parametrize(
    ("effect", "value", "expected"),
    [
        (
            "driveline_damping_ratio",
            2.0,
            replace(
                PARAMETERS,
                flywheel=PARAMETERS.flywheel._replace(damping_nms_rad=16.0),
                shafts=(
                    PARAMETERS.shafts[0]._replace(damping_nms_rad=3.0),
                    PARAMETERS.shafts[1]._replace(damping_nms_rad=3.0),
                ),
                output=PARAMETERS.output._replace(shaft_damping_nms_rad=160.0),
            ),
        ),
        ("crank_ripple_ratio", 0.5, replace(PARAMETERS, engine=PARAMETERS.engine._replace(ripple_ratio=0.5))),
        ("friction_fade_per_k", 0.001, replace(PARAMETERS, lining=PARAMETERS.lining._replace(fade_per_k=0.001))),
        ("film_mobility_ratio", 2.0, replace(PARAMETERS, lining=PARAMETERS.lining._replace(film_mobility_ratio=2.0))),
    ],
)
def test_an_effect_on_the_plant_changes_its_number_only(effect: str, value: float, expected: PlantParameters) -> None:
    vehicle = vehicle_with(**{effect: value})
    assert vehicle.parameters == expected
    assert vehicle.calibration == NOMINAL


@pytest.mark.parametrize("name", [member.name for member in fields(Effects) if member.metadata])
def test_every_number_has_its_range(name: str) -> None:
    member = next(one for one in fields(Effects) if one.name == name)
    for limit, step in (("low", -1), ("high", 1)):
        with pytest.raises(EmulatorConfigError, match=name):
            Effects(**{name: member.metadata[limit] + step})
        assert getattr(Effects(**{name: member.metadata[limit]}), name) == member.metadata[limit]
