"""Differential, wheels and tyres as the estimator knows them."""

from dataclasses import asdict

import pytest

from benchmarks.full_estimator import Vehicle, nominal_vehicle
from clutch_model.errors import CalibrationError
from ecu_emulator.plant import nominal_parameters


def test_the_vehicle_that_ships_is_the_nominal_plant_s() -> None:
    plant, believed = nominal_parameters(), nominal_vehicle()
    grip_n = plant.vehicle.tyre_friction_ratio * plant.vehicle.driven_load_ratio * plant.vehicle.mass_kg * 9.81
    assert believed.tyre_grip_n == pytest.approx(grip_n, rel=1e-6)
    assert believed.mass_kg == plant.vehicle.mass_kg
    assert believed.wheel_inertia_kg_m2 == plant.vehicle.wheel_inertia_kg_m2
    assert believed.efficiency_ratio == plant.synchroniser.efficiency_ratio


@pytest.mark.parametrize(
    ("change", "message"),
    [({"mass_kg": 0.0}, "mass_kg must be > 0"), ({"efficiency_ratio": 1.1}, "must be <= 1"), ({"wings": 2.0}, "wings")],
)
def test_a_vehicle_that_cannot_be_is_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        Vehicle.from_mapping(asdict(nominal_vehicle()) | change)
