"""One drive before it begins: the vehicle that is built for a scenario, its causes of trouble, and its trips."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import Any, Final, Self, TypeVar

import numpy as np

from canlog.e2e.message_contract import MessageContract
from clutch_model.calibration import CONVERTERS, Calibration, ClutchCalibration, Converter, shipped_table, with_clutch
from clutch_model.errors import CalibrationError
from clutch_model.pack import friction_law, kinetic_friction
from clutch_model.units import rad_s_from_rpm
from ecu_emulator.bus.frames import FrameEncoder
from ecu_emulator.driving.journey import Car, Departure, DriveConditions, Journey, PlannedTrip, Trip, Warmth
from ecu_emulator.driving.traffic import SpeedTrace
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.plant.course import DriveSettings, FrictionFactors
from ecu_emulator.plant.parameters import PlantParameters, plant_table
from ecu_emulator.scenario.faults import CauseKind, Degradation, Sensors, generator, split_unit
from ecu_emulator.scenario.scenario import MAX_CYCLES, Effects, FluidCondition, Overrides, ProductionScatter, Scenario
from ecu_emulator.sensing import Installation, Schedule
from ecu_emulator.truth import CauseTruth, DriveTruth, TripTruth

EITHER_WAY: Final = frozenset({CauseKind.WRONG_FLUID, CauseKind.PRESSURE_SENSOR, CauseKind.TORQUE_SENSOR})
PER_STRENGTH: Final[Mapping[CauseKind, Mapping[str, float]]] = {  # natural logarithms of ratios, or what is added
    CauseKind.AGED_FLUID: {"mu_c": -0.05, "mu_s": 0.05, "viscosity": -0.03},
    CauseKind.WATER: {"mu_c": 0.015, "mu_s": 0.05, "erratic": 0.03, "viscosity": 0.06, "open_drag": 0.4,
                      "solenoid_lag": 0.25},
    CauseKind.WRONG_FLUID: {"mu_c": -0.04, "mu_s": 0.04, "viscosity": 0.15},
    CauseKind.AIR: {"pack_compliance": 0.5, "solenoid_lag": 0.15, "open_drag": -0.2},
    CauseKind.WEAK_PUMP: {"supply": -0.2, "orifice": -0.12},
    CauseKind.TORQUE_SENSOR: {"torque_gain": 0.04, "torque_zero_nm": 1.0},
    CauseKind.SYNCHRONISER: {"synchroniser_torque": -0.25},
    CauseKind.GLAZED_LINING: {"mu_c": -0.06, "mu_s": -0.05, "permeability": -0.5, "roughness": -0.05},
    CauseKind.WORN_LINING: {"fill_stroke": 0.1},
    CauseKind.RETURN_SPRING: {"spring_preload_n": -40.0},
    CauseKind.PRESSURE_SENSOR: {"pressure_gain": 0.04, "pressure_zero_pa": 1.5e3},
    CauseKind.DRAGGING_CLUTCH: {"open_gap": -0.4, "open_drag": 0.6},
}  # fmt: skip
_OF_CLUTCH: Final[Mapping[str, str]] = {  # numbers of a clutch, and the changes that multiply them
    "friction.mu_c": "mu_c", "friction.mu_s": "mu_s", "piston.fill_stroke_m": "fill_stroke",
    "film.permeability_m2": "permeability", "film.roughness_m": "roughness", "film.open_gap_m": "open_gap",
}  # fmt: skip
_OF_PLANT: Final[Mapping[str, str]] = {  # likewise of the plant
    "hydraulics.supply_ratio": "supply", "hydraulics.solenoid_lag_s": "solenoid_lag",
    "hydraulics.pack_compliance_m3_pa": "pack_compliance", "hydraulics.orifice_m3_s_sqrt_pa": "orifice",
    "synchroniser.torque_nm": "synchroniser_torque",
}  # fmt: skip
SCATTER_LOG: Final = 0.25  # of each number from car to car, and of what all of a cause's have in common
_EACH: Final = ("clutch1", "clutch2")
_NOTHING: Final[Mapping[str, float]] = MappingProxyType({})
RecordT = TypeVar("RecordT")


@dataclass(frozen=True, slots=True, kw_only=True)
class CausedChanges:
    """What the causes of one car make of it, at their strength as a drive begins."""

    truths: tuple[CauseTruth, ...]
    both: Mapping[str, float]  # logarithms and summands, all causes together
    each: tuple[Mapping[str, float], Mapping[str, float]]  # of each clutch, with those of both

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """Return them; the same vehicle seed draws the same."""
        truths, both, each = [], dict[str, float](), (dict[str, float](), dict[str, float]())
        for cause in scenario.causes:
            strength = cause.strength_at(scenario.odometer_m)
            clutch, drawn = _drawn(cause, scenario.seed_of_vehicle)
            clutch = min(clutch, 1) if scenario.transmission in CONVERTERS else clutch  # whose only one is the first
            if strength == 0.0:
                continue
            changes = {name: strength * size for name, size in drawn.items()}
            for sums in (both, *each) if clutch == 0 else (each[clutch - 1],):
                for name, size in changes.items():
                    sums[name] = sums.get(name, 0.0) + size
            added = {name for name in changes if name == "erratic" or name.endswith(("_nm", "_n", "_pa"))}
            shown = {name: size if name in added else math.exp(size) for name, size in changes.items()}
            truths.append(CauseTruth(kind=cause.kind, strength=strength, clutch=clutch or None, changes=shown))
        return cls(truths=tuple(truths), both=both, each=each)

    def calibration(self, sound: Calibration) -> Calibration:
        """Return clutches and fluid as they are with these causes."""
        clutches = sound.clutches
        for number, (clutch, changes) in enumerate(zip(sound.clutches, self.each, strict=True), start=1):
            factors = {name: _ratio(changes, change) for name, change in _OF_CLUTCH.items()}
            preload_n = {"piston.spring_preload_n": changes.get("spring_preload_n", 0.0)}
            clutches = with_clutch(clutches, number, changed(clutch, factors, preload_n))
        return changed(replace(sound, clutches=clutches), {"viscosity.a_pa_s": _ratio(self.both, "viscosity")})

    def parameters(self, sound: PlantParameters) -> PlantParameters:
        """Return what is around the clutches."""
        drags = (size * _ratio(changes, "open_drag") for size, changes in zip(sound.open_drags, self.each, strict=True))
        erratic_ratio = math.hypot(sound.lining.erratic_ratio, self.both.get("erratic", 0.0))
        return replace(
            changed(sound, {name: _ratio(self.both, change) for name, change in _OF_PLANT.items()}),
            lining=sound.lining._replace(erratic_ratio=erratic_ratio),
            open_drags=type(sound.open_drags)(*drags),
        )

    def sensors(self, sound: Sensors) -> Sensors:
        """Return how the sensors err."""
        drifted = dict(sound)
        errors = {
            f"{clutch}_pressure_pa": (changes, "pressure") for clutch, changes in zip(_EACH, self.each, strict=True)
        }
        errors |= {"lockup_pressure_pa": (self.each[0], "pressure"), "engine_torque_nm": (self.both, "torque")}
        for quantity, (changes, name) in errors.items():
            zero = changes.get(f"{name}_zero_{'pa' if name == 'pressure' else 'nm'}", 0.0)
            drifted[quantity] = changed(
                drifted[quantity], {"gain_ratio": _ratio(changes, f"{name}_gain")}, {"offset": zero}
            )
        return drifted


def _drawn(cause: Degradation, seed: int) -> tuple[int, dict[str, float]]:
    """Return the clutch, 0 of both, and what a strength of 1 does in this vehicle."""
    rng = generator(seed, f"cause {cause.kind}")
    clutch, sign = int(rng.integers(1, 3)), float(rng.choice((-1.0, 1.0)))
    common = float(rng.standard_normal())
    single = rng.standard_normal(len(PER_STRENGTH[cause.kind]))
    factors: Sequence[float] = np.exp(SCATTER_LOG * (0.5 * common + 0.75 * single)).tolist()
    sign = sign if cause.kind in EITHER_WAY else 1.0
    sizes = PER_STRENGTH[cause.kind].items()
    drawn = {name: sign * size * factor for (name, size), factor in zip(sizes, factors, strict=True)}
    return (cause.clutch or clutch) if cause.kind.is_of_one_clutch else 0, drawn


def _ratio(changes: Mapping[str, float], name: str) -> float:
    return math.exp(changes.get(name, 0.0))


def changed(record: RecordT, times: Mapping[str, float], plus: Mapping[str, float] = _NOTHING) -> RecordT:
    """Return a record, numbers of which are multiplied, then added to; a dot leads into a member."""
    changes: dict[str, Any] = {}
    for name in dict.fromkeys(path.partition(".")[0] for path in (*times, *plus)):
        member = getattr(record, name)
        start = f"{name}."
        inner = [
            {path.removeprefix(start): by for path, by in some.items() if path.startswith(start)}
            for some in (times, plus)
        ]
        is_number = not any(inner)
        changes[name] = member * times.get(name, 1.0) + plus.get(name, 0.0) if is_number else changed(member, *inner)
    copied: Any = record
    made: RecordT = copied._replace(**changes) if isinstance(record, tuple) else replace(copied, **changes)
    return made


_FRESH: Final = (1.0, 1.0)
_MEASURED_PACKS: Final = {**{f"{name}_pressure_pa": name for name in _EACH}, "lockup_pressure_pa": "clutch1"}
TRUTH_SLIPS_RPM: Final = (10, 20, 40, 60, 100, 200)
_PER_CLUTCH: Final = frozenset({"piston_area_ratio", "touch_pressure_pa", "pressure_zero_pa"})
_DELAYED_UNITS: Final = frozenset({"rad_s"})  # the speeds that torque and pressure are compared with


def affected_calibration(calibration: Calibration, effects: Effects) -> Calibration:
    """Return the calibration as the effects make it, equal to the given one without any."""
    factors = {
        "friction.stribeck_speed_rad_s": effects.stribeck_speed_ratio,
        "geometry.piston_area_m2": effects.piston_area_ratio,
        "film.contact_stiffness_pa": effects.contact_stiffness_ratio,
    }
    spring_n = {"piston.spring_preload_n": effects.spring_force_n}
    first, second = (changed(clutch, factors, spring_n) for clutch in calibration.clutches)
    return changed(replace(calibration, clutches=(first, second)), {"viscosity.a_pa_s": effects.viscosity_ratio})


def affected_parameters(parameters: PlantParameters, effects: Effects) -> PlantParameters:
    """Return the plant's parameters as the effects make them.

    Raises CalibrationError if an effect leads outside a physical range.
    """
    damping = effects.driveline_damping_ratio
    first, second = (changed(shaft, {"damping_nms_rad": damping}) for shaft in parameters.shafts)
    factors = {
        "flywheel.damping_nms_rad": damping,
        "output.shaft_damping_nms_rad": damping,
        "lining.film_mobility_ratio": effects.film_mobility_ratio,
        "lining.open_drag_ratio": effects.open_drag_ratio,
    }
    summands = {
        "engine.ripple_ratio": effects.crank_ripple_ratio,
        "lining.fade_per_k": effects.friction_fade_per_k,
        "lining.open_drag_limit_nm": effects.open_drag_limit_nm,
    }
    return changed(replace(parameters, shafts=(first, second)), factors, summands)


FLUID_FACTORS: Final[Mapping[FluidCondition, tuple[float, float]]] = {
    FluidCondition.IDEAL: _FRESH,
    FluidCondition.CASE_1: (0.95, 1.05),
    FluidCondition.CASE_2: (0.85, 1.15),
    FluidCondition.AGEING: _FRESH,  # at the start
}
"""Factors on (mu_C, mu_S) of both clutches; clutch_model/calibrations/nominal.toml."""


def ageing_factors(cycles: int) -> tuple[tuple[float, float], ...]:
    """Return factors on (mu_C, mu_S) in cycles 0, 1, ..., ``cycles``: a straight line from fresh to case 2."""
    aged = FLUID_FACTORS[FluidCondition.CASE_2]
    shares = [cycle / cycles for cycle in range(cycles + 1)]
    return tuple((1.0 + share * (aged[0] - 1.0), 1.0 + share * (aged[1] - 1.0)) for share in shares)


@dataclass(frozen=True, slots=True, kw_only=True)
class BuiltVehicle:
    """One individual vehicle: what is true for it, and how its sensors err; friction as the drive begins."""

    calibration: Calibration
    parameters: PlantParameters
    sensors: Sensors
    drawn: Mapping[str, float]  # deviation from the type by name; ratios are relative deviations
    causes: tuple[CauseTruth, ...] = ()


def build_vehicle(scenario: Scenario) -> BuiltVehicle:
    """Return the vehicle of a scenario; the same scenario and vehicle seed always give the same one.

    Raises ConfigError if a truth override names an unknown key or leads outside a physical range.
    """
    faulty = CausedChanges.of(scenario)
    drawn = _draw(scenario.scatter, scenario.seed_of_vehicle, has_converter=scenario.transmission in CONVERTERS)
    try:
        table = _overridden(shipped_table(scenario.transmission), scenario.truth.calibration, "truth.calibration")
        calibration = affected_calibration(Calibration.from_mapping(table), scenario.effects)
        plant = _overridden(plant_table(scenario.transmission), scenario.truth.plant, "truth.plant")
        parameters = affected_parameters(PlantParameters.from_mapping(plant), scenario.effects)
        first, second = (
            _scattered_clutch(clutch, name, drawn, FLUID_FACTORS[scenario.fluid.condition])
            for clutch, name in zip(calibration.clutches, _EACH, strict=True)
        )
        converter = _scattered_converter(calibration.converter, drawn)
        calibration = changed(
            replace(calibration, clutches=(first, second), converter=converter),
            {
                "viscosity.a_pa_s": 1.0 + drawn["viscosity_ratio"],
                "input_side.engine_inertia_kg_m2": 1.0 + drawn["engine_inertia_ratio"],
            },
        )
        inertias = dict.fromkeys(
            ("clutch_inertia_kg_m2", "gear_inertia_kg_m2"), 1.0 + drawn["input_shaft_inertia_ratio"]
        )
        shaft1, shaft2 = (changed(shaft, inertias) for shaft in parameters.shafts)
        return BuiltVehicle(
            calibration=faulty.calibration(calibration),
            parameters=faulty.parameters(replace(parameters, shafts=(shaft1, shaft2))),
            sensors=faulty.sensors(_scattered_sensors(scenario.sensors, drawn)),
            drawn=drawn,
            causes=faulty.truths,
        )
    except CalibrationError as exc:
        raise EmulatorConfigError(f"scenario {scenario.name}: truth is not possible: {exc}") from exc


def _draw(scatter: ProductionScatter, seed: int, *, has_converter: bool) -> dict[str, float]:
    """Draw every deviation from a generator of its own, so that one more does not change the others."""
    drawn: dict[str, float] = {}
    for name, std in asdict(scatter).items():
        if name.startswith("converter") and not has_converter:
            continue
        keys = [f"{clutch}_{name}" for clutch in _EACH] if name in _PER_CLUTCH else [name]
        drawn |= {key: 0.0 + std * float(generator(seed, f"scatter {key}").standard_normal()) for key in keys}
    return drawn


def _scattered_clutch(
    clutch: ClutchCalibration, name: str, drawn: Mapping[str, float], factors: tuple[float, float]
) -> ClutchCalibration:
    area_ratio = 1.0 + drawn[f"{name}_piston_area_ratio"]
    area_m2 = clutch.geometry.piston_area_m2 * area_ratio
    return changed(
        clutch,
        {"geometry.piston_area_m2": area_ratio, "friction.mu_c": factors[0], "friction.mu_s": factors[1]},
        {"piston.spring_preload_n": drawn[f"{name}_touch_pressure_pa"] * area_m2},
    )


def _scattered_converter(converter: Converter | None, drawn: Mapping[str, float]) -> Converter | None:
    if converter is None:
        return None
    level, rise = drawn["converter_capacity_ratio"], drawn["converter_shape_ratio"]
    places = zip(converter.speed_ratios, converter.capacities_nm_s2, strict=True)
    capacities = tuple(value * (1.0 + level + rise * (2.0 * place - 1.0)) for place, value in places)
    return replace(converter, capacities_nm_s2=capacities)


def _scattered_sensors(sensors: Sensors, drawn: Mapping[str, float]) -> Sensors:
    """Add gain, zero and latency errors; only differences of latency matter, so the earliest chain defines zero."""
    latency_s = {"torque": drawn["torque_latency_s"], "pressure": drawn["pressure_latency_s"], "speed": 0.0}
    base_s = -min(latency_s.values())
    errors = {"engine_torque_nm": ("torque", drawn["torque_gain_ratio"], drawn["torque_offset_nm"])}
    for quantity, clutch in _MEASURED_PACKS.items():
        errors[quantity] = ("pressure", 0.0, drawn[f"{clutch}_pressure_zero_pa"])
    scattered = dict(sensors)
    for quantity, sensor in sensors.items():
        if quantity in errors or split_unit(quantity)[1] in _DELAYED_UNITS:
            chain, gain_ratio, offset = errors.get(quantity, ("speed", 0.0, 0.0))
            scattered[quantity] = replace(
                sensor,
                gain_ratio=sensor.gain_ratio * (1.0 + gain_ratio),
                offset=sensor.offset + offset,
                latency_s=sensor.latency_s + base_s + latency_s[chain],
            )
    return scattered


def _overridden(table: dict[str, Any], overrides: Overrides, where: str) -> dict[str, Any]:
    """Replace leaves of nested tables (parsed afresh, so ours to change) by dotted key.

    A number at the end of a part chooses from an array of tables: ``clutch2.friction.mu_c``.
    """
    for dotted, value in overrides.items():
        *path, leaf = dotted.split(".")
        node: Any = table
        for part in path:
            node = _child(node, part)
        if not isinstance(node, dict) or leaf not in node or isinstance(node[leaf], dict):
            raise EmulatorConfigError(f"{where}.{dotted} is unknown")
        node[leaf] = value
    return table


def _child(node: Any, part: str) -> Any:  # noqa: ANN401 - parsed TOML
    if not isinstance(node, dict):
        return None
    if part in node:
        return node[part]
    members, number = node.get(part[:-1]), part[-1:]
    if isinstance(members, list) and number.isdigit() and 1 <= int(number) <= len(members):
        return members[int(number) - 1]
    return None


MakeTrip = Callable[[Car, SpeedTrace, DriveConditions, np.random.Generator], Trip]
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
    law, has_converter = friction_law(first), vehicle.calibration.converter is not None
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
        causes=vehicle.causes,
        mu_at_slip_rpm={
            rpm: float(kinetic_friction(float(rad_s_from_rpm(rpm)), law)) for rpm in TRUTH_SLIPS_RPM if has_converter
        },
    )


def journey(
    scenario: Scenario,
    vehicle: Callable[[], BuiltVehicle],
    longest_stay_s: float,
    planned: Iterator[PlannedTrip],
    believed: Callable[[], tuple[float, float] | None] = lambda: None,
    make_trip: MakeTrip = Trip,
) -> Journey:
    """Return a drive on the road; a parked car is silent for at most ``longest_stay_s`` [s].

    As each trip begins, ``vehicle`` is asked for the car as it is by then, ``believed`` for the touch points that the
    control believes in. Raises ConfigError if the car cannot be driven under the scenario's conditions.
    """
    ambient = scenario.ambient
    warmth = Warmth(oil_k=ambient.oil_temperature_k, coolant_k=ambient.coolant_temperature_k)

    def depart(departure: Departure) -> Trip:
        return make_trip(
            Car(truth=vehicle().calibration, parameters=vehicle().parameters, touch_pressures_pa=believed()),
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
