"""A scenario's drive on the road: which trips there are, and which car drives them under which conditions."""

import math
from collections.abc import Callable, Iterator
from typing import Final

from clutch_model.calibration import Calibration
from ecu_emulator.drive.build import BuiltVehicle, ageing_factors
from ecu_emulator.driving.conditions import Car, DriveConditions
from ecu_emulator.driving.journey import Departure, Journey, MovingCar, Warmth
from ecu_emulator.driving.trip import Trip
from ecu_emulator.driving.trips import PlannedTrip, trips
from ecu_emulator.plant.drive import FrictionFactors
from ecu_emulator.scenario.scenario import FluidCondition, Scenario
from ecu_emulator.scenario.signals import generator
from ecu_emulator.truth.records import TripTruth

WHOLE_STAY_S: Final = math.inf


def scenario_trips(scenario: Scenario) -> Iterator[PlannedTrip]:
    """Yield the trips that a scenario names."""
    return trips(scenario.drive, scenario.seed_of_drive, None if scenario.endless else scenario.cycles)


def journey(
    scenario: Scenario,
    vehicle: BuiltVehicle,
    longest_stay_s: float,
    planned: Iterator[PlannedTrip],
    believed: Callable[[], tuple[float, float] | None] = lambda: None,
) -> Journey:
    """Return a drive on the road; a parked car is silent for at most ``longest_stay_s`` [s].

    ``believed`` is asked, as each trip begins, for the touch points that the control believes in.

    Raises
    ------
    ConfigError
        If the car cannot be driven under the scenario's conditions.
    """
    ambient = scenario.ambient
    warmth = Warmth(oil_k=ambient.oil_temperature_k, coolant_k=ambient.coolant_temperature_k)

    def depart(departure: Departure) -> MovingCar:
        return Trip(
            Car(truth=vehicle.calibration, parameters=vehicle.parameters, touch_pressures_pa=believed()),
            departure.trip.trace,
            DriveConditions(
                oil_k=departure.warmth.oil_k,
                coolant_k=departure.warmth.coolant_k,
                ambient_k=ambient.temperature_k,
                friction_factors=friction_factors(scenario, departure.number),
            ),
            generator(scenario.seed_of_drive, f"driver {departure.number}"),
        )

    return Journey(planned, depart, warmth, ambient.temperature_k, longest_stay_s)


def friction_factors(scenario: Scenario, trip_number: int) -> FrictionFactors:
    """Return the factors on friction during one trip: an ageing fluid ages from trip to trip."""
    if scenario.fluid.condition is not FluidCondition.AGEING:
        return FrictionFactors()
    factors = ageing_factors(scenario.fluid.ageing_cycles)
    mu_c, mu_s = factors[min(trip_number - 1, len(factors) - 1)]
    return FrictionFactors(mu_c1=mu_c, mu_s1=mu_s, mu_c2=mu_c, mu_s2=mu_s)


def trip_truth(departure: Departure, scenario: Scenario, calibration: Calibration) -> TripTruth:
    """Return the truth of a trip that begins."""
    factors = friction_factors(scenario, departure.number)
    first, second = (clutch.friction for clutch in calibration.clutches)
    return TripTruth(
        number=departure.number,
        trace=departure.trip.trace.name,
        t_start_s=departure.t_start_s,
        parked_s=departure.trip.parked_s,
        distance_m=departure.trip.trace.distance_m,
        oil_temperature_k=departure.warmth.oil_k,
        coolant_temperature_k=departure.warmth.coolant_k,
        mu_c=(first.mu_c * factors.mu_c1, second.mu_c * factors.mu_c2),
        mu_s=(first.mu_s * factors.mu_s1, second.mu_s * factors.mu_s2),
    )
