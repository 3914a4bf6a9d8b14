"""What the parts of a drive need to know of its scenario and its vehicle."""

from collections.abc import Mapping
from typing import Final

from canlog.e2e.message_contract import MessageContract
from ecu_emulator.bus.frames import FrameEncoder
from ecu_emulator.drive.build import BuiltVehicle, ageing_factors
from ecu_emulator.plant.drive import DriveSettings, FrictionFactors
from ecu_emulator.scenario.scenario import MAX_CYCLES, FluidCondition, Scenario
from ecu_emulator.sensing.readings import Schedule
from ecu_emulator.sensing.sensors import Installation
from ecu_emulator.truth.records import DriveTruth

ROAD_MESSAGES: Final = frozenset({"ECM_State", "TCU_Drive"})


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
