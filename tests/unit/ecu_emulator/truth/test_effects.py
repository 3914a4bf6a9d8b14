"""Effects that the service's model lacks: each changes what it should and nothing else."""

from dataclasses import fields, replace

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from ecu_emulator.drive.build import BuiltVehicle, build_vehicle
from ecu_emulator.errors import ConfigError
from ecu_emulator.plant.clutch import friction_ratio
from ecu_emulator.plant.drive import DriveSettings
from ecu_emulator.plant.parameters import PlantParameters, nominal_parameters
from ecu_emulator.plant.powertrain import Powertrain
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario.scenario import Effects, Scenario
from tests.support.builders import drive_scenario

NOMINAL = nominal_calibration()
PARAMETERS = nominal_parameters()
HOT_K = 363.15
DRIVE_S = 4.0


def scenario_with(**effects: float) -> Scenario:
    return replace(drive_scenario(), effects=Effects(**effects))  # type: ignore[arg-type]  # one of them is a flag


def vehicle_with(**effects: float) -> BuiltVehicle:
    return build_vehicle(scenario_with(**effects))


def rows_with(**effects: float) -> FloatArray:
    vehicle = vehicle_with(**effects)
    return Powertrain(vehicle.calibration, vehicle.parameters, DriveSettings()).advance(DRIVE_S)


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
        with pytest.raises(ConfigError, match=name):
            Effects(**{name: member.metadata[limit] + step})
        assert getattr(Effects(**{name: member.metadata[limit]}), name) == member.metadata[limit]


def test_friction_fades_with_the_heat_of_the_pack() -> None:
    lining = PARAMETERS.lining._replace(fade_per_k=0.002)
    assert friction_ratio(HOT_K, lining) == pytest.approx(1.0 - 0.002 * 10.0)
    assert friction_ratio(lining.fade_reference_k, lining) == 1.0
    rows = rows_with(friction_fade_per_k=0.002)
    for mu, temperature in ((Col.MU_C1, Col.CLUTCH1_TEMPERATURE), (Col.MU_S2, Col.CLUTCH2_TEMPERATURE)):
        reference = 0.140 if mu == Col.MU_C1 else 0.119
        assert rows[:, mu] == pytest.approx(reference * (1.0 - 0.002 * (rows[:, temperature] - 353.15)))
    assert np.ptp(rows[:, Col.MU_C2]) > 0.0


def test_the_crank_ripples_and_the_broadcast_torque_does_not() -> None:
    plain, rippled = rows_with(), rows_with(crank_ripple_ratio=0.5)
    pulling = slice(500, 1500)

    def roughness(rows: FloatArray, column: Col) -> float:
        return float(np.std(np.diff(rows[pulling, column], n=3)))

    assert roughness(rippled, Col.ENGINE_SPEED) > 20.0 * roughness(plain, Col.ENGINE_SPEED)
    # The modelled torque still sees the rippled speed through friction, a hundredth of the pulses.
    assert roughness(rippled, Col.ENGINE_TORQUE) < 1.0
    assert rippled[pulling, Col.ENGINE_TORQUE] == pytest.approx(plain[pulling, Col.ENGINE_TORQUE], rel=0.05)
