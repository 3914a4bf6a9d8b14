"""A vehicle built from its truth, and causes that change it."""

from dataclasses import replace

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from ecu_emulator.commands import DriveOptions, choose_scenario
from ecu_emulator.drive.build import PER_STRENGTH, BuiltVehicle, build_vehicle, drive_truth
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.plant.parameters import nominal_parameters
from ecu_emulator.scenario.faults import NOMINAL_SENSORS, CauseKind, Degradation
from ecu_emulator.scenario.scenario import Truth, production_scatter
from ecu_emulator.scenario.scenario_file import load_scenario
from tests.support.builders import drive_scenario


def test_without_scatter_the_vehicle_is_the_nominal_one() -> None:
    vehicle = build_vehicle(drive_scenario("noise_only"))
    assert vehicle.calibration == nominal_calibration()
    assert vehicle.parameters == nominal_parameters()
    assert dict(vehicle.sensors) == dict(NOMINAL_SENSORS)
    assert set(vehicle.drawn.values()) == {0.0}


def test_drawn_deviations_have_the_stated_spread() -> None:
    scatter = production_scatter()
    drawn = [build_vehicle(drive_scenario("ideal", seed=seed)).drawn for seed in range(80)]
    for name, deviations in {key: np.array([one[key] for one in drawn]) for key in drawn[0]}.items():
        std = getattr(scatter, name.removeprefix("clutch1_").removeprefix("clutch2_"))
        assert np.std(deviations) == pytest.approx(std, rel=0.35), name
        assert abs(np.mean(deviations)) <= 4.0 * std / np.sqrt(80), name


def test_each_deviation_reaches_its_place() -> None:
    vehicle, nominal = build_vehicle(drive_scenario("ideal", seed=3)), nominal_calibration()
    drawn = vehicle.drawn
    for number, (clutch, believed) in enumerate(zip(vehicle.calibration.clutches, nominal.clutches, strict=True), 1):
        area_ratio = clutch.geometry.piston_area_m2 / believed.geometry.piston_area_m2
        assert area_ratio - 1.0 == pytest.approx(drawn[f"clutch{number}_piston_area_ratio"])
        touch_pa = clutch.touch_pressure_pa - believed.touch_pressure_pa / area_ratio
        assert touch_pa == pytest.approx(drawn[f"clutch{number}_touch_pressure_pa"])
        assert clutch.friction == believed.friction
        zero_pa = vehicle.sensors[f"clutch{number}_pressure_pa"].offset
        assert zero_pa == drawn[f"clutch{number}_pressure_zero_pa"]
    inertia_ratio = vehicle.calibration.input_side.engine_inertia_kg_m2 / nominal.input_side.engine_inertia_kg_m2
    assert inertia_ratio - 1.0 == pytest.approx(drawn["engine_inertia_ratio"])
    assert vehicle.calibration.viscosity.a_pa_s / nominal.viscosity.a_pa_s - 1.0 == pytest.approx(
        drawn["viscosity_ratio"]
    )
    torque = vehicle.sensors["engine_torque_nm"]
    assert (torque.gain_ratio - 1.0, torque.offset) == pytest.approx(
        (drawn["torque_gain_ratio"], drawn["torque_offset_nm"])
    )


def test_truth_overrides_reach_calibration_and_plant() -> None:
    truth = Truth(
        calibration={"clutch2.friction.mu_c": 0.15, "viscosity.b_k": 700.0},
        plant={"shaft1.stiffness_nm_rad": 9000.0, "vehicle.mass_kg": 1800.0},
    )
    vehicle = build_vehicle(replace(drive_scenario("noise_only"), truth=truth))
    assert [clutch.friction.mu_c for clutch in vehicle.calibration.clutches] == [0.14, 0.15]
    assert vehicle.calibration.viscosity.b_k == 700.0
    assert [shaft.stiffness_nm_rad for shaft in vehicle.parameters.shafts] == [9000.0, 7500.0]
    assert vehicle.parameters.vehicle.mass_kg == 1800.0


IDEAL = load_scenario("ideal")
SOUND = build_vehicle(IDEAL)


def built(said: str, seed: int = 1) -> BuiltVehicle:
    return build_vehicle(replace(choose_scenario(DriveOptions(scenario=IDEAL, cause=said)), vehicle_seed=seed))


def test_water_makes_friction_erratic_from_shift_to_shift() -> None:
    def spread(cause: str | None) -> float:
        _, truth = frames_of(replace(choose_scenario(DriveOptions(scenario=IDEAL, cause=cause)), cycles=1))
        levels = [shift.mu_c / truth.drive.mu_c[shift.clutch - 1] for shift in truth.shifts]
        return max(levels) - min(levels)

    assert spread(None) == 0.0
    assert spread("water:2") > 0.05


def test_a_cause_grows_by_the_odometer_and_the_truth_names_it() -> None:
    growing = Degradation(kind=CauseKind.GLAZED_LINING, strength=2.0, clutch=1, begins_m=1e6, grows_over_m=2e6)
    assert [growing.strength_at(km * 1e6) for km in (0.5, 1.0, 2.0, 3.0, 9.0)] == [0.0, 0.0, 1.0, 2.0, 2.0]
    for odometer_m, strengths in ((5e5, []), (2e6, [1.0]), (4e6, [2.0])):
        scenario = replace(IDEAL, causes=(growing,), odometer_m=odometer_m)
        truth = drive_truth(scenario, build_vehicle(scenario))
        assert [(one.kind, one.clutch) for one in truth.causes] == [("glazed-lining", 1)] * len(strengths)
        assert [one.strength for one in truth.causes] == strengths


def test_every_cause_changes_the_car() -> None:
    assert set(PER_STRENGTH) == set(CauseKind)
    for kind in CauseKind:
        faulty = built(kind.value)
        assert (faulty.calibration, faulty.parameters, faulty.sensors) != (
            SOUND.calibration,
            SOUND.parameters,
            SOUND.sensors,
        )
