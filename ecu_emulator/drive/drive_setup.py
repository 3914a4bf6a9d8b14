"""What a drive needs to know of its scenario and its vehicle, and its trips on the road."""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Final

from canlog.e2e.message_contract import MessageContract
from clutch_model.calibration import Calibration
from ecu_emulator.bus.frames import FrameEncoder
from ecu_emulator.drive.build import BuiltVehicle, ageing_factors
from ecu_emulator.driving.journey import Departure, Journey, MovingCar, PlannedTrip, Warmth, trips
from ecu_emulator.driving.trip import Car, DriveConditions, Trip
from ecu_emulator.plant.drive import DriveSettings, FrictionFactors
from ecu_emulator.scenario.scenario import MAX_CYCLES, FluidCondition, Scenario
from ecu_emulator.scenario.signals import generator
from ecu_emulator.sensing.sensors import Installation, Schedule
from ecu_emulator.truth.records import DriveTruth, TripTruth

ROAD_MESSAGES: Final = frozenset({"ECM_State", "TCU_Drive"})
WHOLE_STAY_S: Final = math.inf


def schedules(scenario: Scenario, contracts: Mapping[str, MessageContract], encoder: FrameEncoder) -> list[Schedule]:
    """Return when each message is sent; the shift cycle keeps to those that it had before there was a road."""
    return [
        Schedule(
            message=contract.name,
            sender=contract.sender,
            cycle_ms=max(contract.cycle_ms, scenario.effects.least_cycle_ms),
            phase_ms=contract.phase_ms,
            quantities=encoder.quantities(contract.name),
        )
        for contract in contracts.values()
        if scenario.is_on_the_road or contract.name not in ROAD_MESSAGES
    ]


def drive_settings(scenario: Scenario) -> DriveSettings:
    """Return what the plant needs to know about the drive."""
    is_ageing = scenario.fluid.condition is FluidCondition.AGEING
    factors = ageing_factors(scenario.fluid.ageing_cycles) if is_ageing else ()
    return DriveSettings(
        # The cycle that belongs to a routine on request comes before those of the scenario.
        cycles=(MAX_CYCLES if scenario.endless else scenario.cycles) + scenario.routine.on_request,
        seed=scenario.seed_of_drive,
        pedal_ratio=scenario.driver.pedal_ratio,
        vary_ratio=scenario.driver.variation_ratio,
        initial_oil_k=scenario.ambient.oil_temperature_k,
        coolant_k=scenario.ambient.coolant_temperature_k,
        ambient_k=scenario.ambient.temperature_k,
        open_revs=scenario.routine.open_revs,
        closed_revs=scenario.routine.closed_revs,
        waits=scenario.routine.on_request,
        friction_factors=tuple(FrictionFactors(mu_c1=c, mu_s1=s, mu_c2=c, mu_s2=s) for c, s in factors),
    )


def installation(scenario: Scenario, vehicle: BuiltVehicle) -> Installation:
    """Return how the sensors are built into the vehicle."""
    return Installation(
        crank_segment_rad=vehicle.calibration.input_side.crank_segment_rad,
        output_ratio=vehicle.parameters.gearbox.final_drive_ratios[0],
        wheel_radius_m=vehicle.parameters.vehicle.wheel_radius_m,
        ambient_temperature_k=scenario.ambient.temperature_k,
        odometer_m=scenario.odometer_m,
        engine_speed_is_sampled=scenario.effects.engine_speed_is_sampled,
        motoring_torque_ratio=scenario.effects.motoring_torque_ratio,
    )


def drive_truth(scenario: Scenario, vehicle: BuiltVehicle) -> DriveTruth:
    """Return the truth about a drive as it begins."""
    first, second = (clutch.friction for clutch in vehicle.calibration.clutches)
    return DriveTruth(
        scenario=scenario.name,
        vehicle=scenario.vehicle,
        seed=scenario.seed,
        vehicle_seed=scenario.seed_of_vehicle,
        drive_seed=scenario.seed_of_drive,
        drive=scenario.drive,
        odometer_m=scenario.odometer_m,
        cycles=scenario.cycles,
        fluid=scenario.fluid.condition,
        mu_c=(first.mu_c, second.mu_c),
        mu_s=(first.mu_s, second.mu_s),
        drawn=vehicle.drawn,
        effects=scenario.effects.switched_on(),
    )


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
