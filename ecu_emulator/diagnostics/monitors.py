"""Monitors: what the controller senses becomes results of tests, one sample of each at a time.

A monitor says nothing where its test cannot tell: while a gear changes, in a launch, at low torque, or where a value is
missing that is not its own matter. Whether samples make a failure is the trouble memory's business.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from clutch_model.calibration import clutch_of_gear
from ecu_emulator.diagnostics.clutches import Pack, heated_k, packs_of
from ecu_emulator.diagnostics.memory import TestResult
from ecu_emulator.diagnostics.values import Values
from ecu_emulator.scenario.signals import SILENCE

Sample = tuple[str, TestResult]  # a trouble code as scan tools show it, and the sample


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorLimits:
    """When a sample counts as failed; a sound drive stays well within (tests hold it)."""

    settled_s: float = 0.3  # since the last change of gear
    tested_torque_nm: float = 40.0  # slip is judged above
    most_slip_rad_s: float = 10.0  # about 100 rpm in a clutch that shall be locked; a sound one stays below 1.5
    most_ratio_error: float = 0.03  # of input over output speed; sensors err by 0.01
    tested_output_rad_s: float = 10.0
    input_output_ratios: tuple[float, ...] = (3.462, 2.150, 1.464, 1.079, 0.8452, 0.7116)  # of gears 1, 2, ...
    packs: tuple[Pack, ...] = field(default_factory=packs_of)
    tested_pressure_pa: float = 3.0e5
    least_pressure_ratio: float = 0.7  # of what is commanded
    stuck_off_ratio: float = 0.2  # of what is commanded: the solenoid does nothing
    most_pressure_excess_pa: float = 1.5e5  # of the clutch that shall be open
    pressures_pa: tuple[float, float] = (-0.5e5, 35.0e5)  # the sensor's range
    most_fluid_k: float = 393.15  # 120 degC
    fluid_range_k: tuple[float, float] = (233.15, 443.15)
    most_fluid_rate_k_s: float = 3.0
    warming_coolant_k: float = 30.0  # so much warmer since the start, and the fluid must have changed
    least_fluid_change_k: float = 2.0
    most_speed_error_rad_s: float = 10.0  # between sensors of shafts that turn together
    longest_shift_s: float = 3.0
    has_converter: bool = False  # with a lock-up clutch in place of two clutches
    lockup_settled_s: float = 0.7  # since gear, state of the lock-up clutch, and engine that pulls or not are the same
    tested_lockup_pa: float = 1.0e5
    most_held_slip_rad_s: float = 15.0  # of one that shall be locked
    most_led_slip_rad_s: float = 30.0  # of one that shall slip by 20 to 60 rpm; one that shudders stays below 20
    least_open_slip_rad_s: float = 1.0  # of a converter that passes the tested torque
    most_clutch_k: float = 423.15  # 150 degC, of a pack as the controller computes it


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """For how long a cycle was driven: what regulations ask of one in which monitors should have run."""

    running_s: float = 0.0
    fast_s: float = 0.0
    idle_s: float = 0.0  # without a break
    has_idled: bool = False

    def later(self, known: Mapping[str, float], duration_s: float) -> "Driven":
        """Return the same after so much more time of this."""
        is_running = known.get("engine_speed_rad_s", 0.0) >= 30.0
        speed_m_s, pedal_ratio = known.get("vehicle_speed_m_s", math.inf), known.get("pedal_ratio", math.inf)
        is_idle = is_running and speed_m_s <= 0.447 and pedal_ratio <= 0.0
        idle_s = self.idle_s + duration_s if is_idle else 0.0
        return Driven(
            running_s=self.running_s + is_running * duration_s,
            fast_s=self.fast_s + (11.1 <= speed_m_s < math.inf) * duration_s,
            idle_s=idle_s,
            has_idled=self.has_idled or idle_s >= 30.0,
        )

    @property
    def is_enough(self) -> bool:
        """Whether it was ten minutes, five of them at 40 km/h or more, with half a minute of idling at a stretch."""
        return self.running_s >= 600.0 and self.fast_s >= 300.0 and self.has_idled


@dataclass(frozen=True, slots=True, kw_only=True)
class Watch:
    """What monitors remember from sample to sample."""

    t_s: float | None = None
    gears: tuple[float, float] = (0.0, 0.0)  # current, target
    since_s: float = 0.0  # when they became so
    fluid_k: float | None = None
    fluid_s: float = 0.0
    fluids_k: tuple[float, float] | None = None  # coldest and warmest in this operation cycle
    start_coolant_k: float | None = None  # as this operation cycle began
    lockup_state: tuple[float | None, bool] = (None, False)  # and whether the engine pulls
    lockup_since_s: float = 0.0  # when it became so
    clutches_k: tuple[float, float] | None = None  # as the controller computes them
    driven: Driven = field(default_factory=Driven)


SENSED: Final = (
    "current_gear", "sump_temperature_k", "clutch1_pressure_pa", "hub_speed_rad_s", "output_speed_rad_s",
)  # fmt: skip
SENSED_OF_CONVERTER: Final = ("current_gear", "sump_temperature_k", "lockup_pressure_pa", "turbine_speed_rad_s")
"""One quantity of every message of the controller's own sensors: before all have come, missing is no fault."""

NOMINAL_LIMITS: Final = MonitorLimits()
LOCKUP_OPEN, LOCKUP_SLIPPING, LOCKUP_LOCKED = 0.0, 2.0, 3.0  # of the states of a lock-up clutch
IN_GEAR: Final = 0.0  # of the drive states
WARM_COOLANT_K: Final = 344.15  # 71 degC, where a warm-up cycle of OBD ends
WARMED_BY_K: Final = 22.2  # 40 degF, that it has become warmer in it at least
PRESSURE_SENSOR_CODES: Final = {1: "P0841", 2: "P0846"}  # by clutch
STUCK_ON_CODES: Final = {1: "P0747", 2: "P0777"}
STUCK_OFF_CODES: Final = {1: "P0746", 2: "P0776"}
RATIO_CODES: Final = ("P0731", "P0732", "P0733", "P0734", "P0735", "P0729", "P076F", "P07D9")  # by gear
LOST_CODES: Final = {"ECM": "U0100", "ABS": "U0121", "IC": "U0155"}  # by sender
_SHAFT_SPEEDS: Final = ("hub_speed_rad_s", "input1_speed_rad_s", "input2_speed_rad_s")


def judge(
    watch: Watch, values: Values, t_s: float, limits: MonitorLimits = NOMINAL_LIMITS
) -> tuple[Watch, tuple[Sample, ...]]:
    """Return what the monitors remember and say at this moment, about ten times a second.

    Parameters
    ----------
    watch
        What they remembered.
    values
        What the controller senses, in SI; values that are not available are missing.
    t_s
        Time that never goes back [s].
    limits
        When a sample fails.
    """
    known = {name: value for name, value in values.items() if isinstance(value, int | float)}
    gears = (known.get("current_gear", 0.0), known.get("target_gear", 0.0))
    since_s = watch.since_s if gears == watch.gears and watch.t_s is not None else t_s
    is_pulling = known.get("engine_torque_nm", 0.0) > limits.tested_torque_nm
    lockup_state = (known.get("lockup_state"), is_pulling)
    lockup_since_s = watch.lockup_since_s if lockup_state == watch.lockup_state else t_s
    samples = (
        *_lost_samples(known),
        *_fluid_samples(watch, known, t_s, limits),
        *_shift_samples(gears, t_s - since_s, limits),
        *(
            _converter_samples(gears, known, (t_s - since_s, t_s - lockup_since_s), limits)
            if limits.has_converter
            else _clutch_samples(gears, known, t_s - since_s, limits)
        ),
    )
    fluid_k = known.get("sump_temperature_k")
    is_oil_believed = ("P0711", TestResult.PREPASSED) in samples and not limits.has_converter
    since_look_s = 0.0 if watch.t_s is None else max(0.0, t_s - watch.t_s)
    clutches_k = heated_k(watch.clutches_k, known, since_look_s, limits.packs) if is_oil_believed else watch.clutches_k
    after = Watch(
        t_s=t_s,
        gears=gears,
        since_s=since_s,
        fluid_k=watch.fluid_k if fluid_k is None else fluid_k,
        fluid_s=watch.fluid_s if fluid_k is None else t_s,
        fluids_k=_widened(watch.fluids_k, fluid_k),
        start_coolant_k=known.get("coolant_temperature_k") if watch.start_coolant_k is None else watch.start_coolant_k,
        lockup_state=lockup_state,
        lockup_since_s=lockup_since_s,
        clutches_k=clutches_k,
        driven=watch.driven.later(known, since_look_s),
    )
    return after, (*samples, *(_heat_samples(clutches_k, known, limits) if is_oil_believed else ()))


def is_warm(watch: Watch, values: Values) -> bool:
    """Return whether the engine has become warm in this operation cycle, as OBD has it: the cycle counts for ageing."""
    coolant_k = values.get("coolant_temperature_k")
    if not isinstance(coolant_k, int | float) or watch.start_coolant_k is None:
        return False
    return coolant_k >= WARM_COOLANT_K and coolant_k - watch.start_coolant_k >= WARMED_BY_K


def _widened(range_k: tuple[float, float] | None, value_k: float | None) -> tuple[float, float] | None:
    if value_k is None:
        return range_k
    low_k, high_k = range_k or (value_k, value_k)
    return min(low_k, value_k), max(high_k, value_k)


def _sample(code: str, *, is_failed: bool) -> Sample:
    return code, TestResult.PREFAILED if is_failed else TestResult.PREPASSED


def _lost_samples(known: Mapping[str, float]) -> Iterator[Sample]:
    for node, code in LOST_CODES.items():
        is_silent = known.get(f"{SILENCE}{node}")
        if is_silent is not None:
            yield _sample(code, is_failed=is_silent > 0.0)


def _fluid_samples(watch: Watch, known: Mapping[str, float], t_s: float, limits: MonitorLimits) -> Iterator[Sample]:
    """Judge the fluid's temperature, and first its sensor: who says nonsense says nothing about heat."""
    fluid_k = known.get("sump_temperature_k")
    low_k, high_k = limits.fluid_range_k
    is_odd = fluid_k is None or not low_k <= fluid_k <= high_k
    if fluid_k is not None and watch.fluid_k is not None:
        most_k = limits.most_fluid_rate_k_s * max(1.0, t_s - watch.fluid_s)  # one step of the sensor at least
        is_odd = is_odd or abs(fluid_k - watch.fluid_k) > most_k
    is_odd = is_odd or _is_frozen(watch, known, limits)
    yield _sample("P0711", is_failed=is_odd)
    if fluid_k is not None and not is_odd:
        yield _sample("P0218", is_failed=fluid_k > limits.most_fluid_k)


def _is_frozen(watch: Watch, known: Mapping[str, float], limits: MonitorLimits) -> bool:
    """Return whether the fluid has stayed as it was while the engine became warm around it."""
    coolant_k, fluids_k = known.get("coolant_temperature_k"), _widened(watch.fluids_k, known.get("sump_temperature_k"))
    if coolant_k is None or watch.start_coolant_k is None or fluids_k is None:
        return False
    has_warmed = coolant_k - watch.start_coolant_k >= limits.warming_coolant_k
    return has_warmed and fluids_k[1] - fluids_k[0] < limits.least_fluid_change_k


def _clutch_samples(
    gears: tuple[float, float], known: Mapping[str, float], lasts_s: float, limits: MonitorLimits
) -> Iterator[Sample]:
    for clutch, code in PRESSURE_SENSOR_CODES.items():
        yield _sample(code, is_failed=_pressure_pa(known, clutch, limits) is None)
    yield _sample("P0715", is_failed=any(known.get(name) is None for name in _SHAFT_SPEEDS))
    yield from _gear_samples(gears, known, lasts_s, limits)


def _converter_samples(
    gears: tuple[float, float], known: Mapping[str, float], last_s: tuple[float, float], limits: MonitorLimits
) -> Iterator[Sample]:
    """Judge a lock-up clutch, and the ratio behind its converter; ``last_s`` tells how long gear and clutch are so."""
    state, pressure_pa = known.get("lockup_state"), _pressure_pa(known, "lockup", limits)
    yield _sample("P0841", is_failed=pressure_pa is None)
    yield _sample("P0715", is_failed=known.get("turbine_speed_rad_s") is None)
    commanded_pa = known.get("lockup_pressure_command_pa")
    if pressure_pa is not None and commanded_pa is not None and last_s[1] >= limits.lockup_settled_s:
        yield _sample("P2758", is_failed=pressure_pa > commanded_pa + limits.most_pressure_excess_pa)
        if commanded_pa > limits.tested_lockup_pa:
            yield _sample("P2757", is_failed=pressure_pa < limits.stuck_off_ratio * commanded_pa)
    slip, torque = known.get("lockup_slip_rad_s"), known.get("engine_torque_nm", 0.0)
    if slip is not None and last_s[1] >= limits.lockup_settled_s:
        if state in {LOCKUP_SLIPPING, LOCKUP_LOCKED}:
            most = limits.most_held_slip_rad_s if state == LOCKUP_LOCKED else limits.most_led_slip_rad_s
            yield _sample("P0741", is_failed=abs(slip) > most)
        elif state == LOCKUP_OPEN and torque > limits.tested_torque_nm and last_s[0] >= limits.lockup_settled_s:
            yield _sample("P0742", is_failed=abs(slip) < limits.least_open_slip_rad_s)
    gear = int(gears[0])
    is_held = gears[0] == gears[1] and last_s[0] >= limits.settled_s
    is_fast = known.get("output_speed_rad_s", 0.0) > 2.0 * limits.tested_output_rad_s  # before the final drive
    if is_held and is_fast and 1 <= gear <= len(limits.input_output_ratios):
        yield from _ratio_samples(gear, "turbine", known, limits)


def _pressure_pa(known: Mapping[str, float], clutch: int | str, limits: MonitorLimits) -> float | None:
    """Return a clutch pressure [Pa], None if its sensor says nothing or nonsense."""
    pressure_pa = known.get(f"clutch{clutch}_pressure_pa" if isinstance(clutch, int) else f"{clutch}_pressure_pa")
    low_pa, high_pa = limits.pressures_pa
    return pressure_pa if pressure_pa is not None and low_pa <= pressure_pa <= high_pa else None


def _heat_samples(
    clutches_k: tuple[float, float] | None, known: Mapping[str, float], limits: MonitorLimits
) -> Iterator[Sample]:
    """Judge the clutches' temperature while pressures can be believed."""
    if clutches_k is not None and all(_pressure_pa(known, clutch, limits) is not None for clutch in (1, 2)):
        yield _sample("P2787", is_failed=max(clutches_k) > limits.most_clutch_k)


def _shift_samples(gears: tuple[float, float], lasts_s: float, limits: MonitorLimits) -> Iterator[Sample]:
    current, target = gears
    if current and target and current != target and lasts_s > limits.longest_shift_s:
        yield _sample("P0780", is_failed=True)
    elif current and current == target:
        yield _sample("P0780", is_failed=False)


def _gear_samples(
    gears: tuple[float, float], known: Mapping[str, float], lasts_s: float, limits: MonitorLimits
) -> Iterator[Sample]:
    """Judge clutches and ratio while a gear is held."""
    gear = int(gears[0])
    is_driven = known.get("drive_state", IN_GEAR) == IN_GEAR  # the shift cycle does not say: it always is
    is_held = gears[0] == gears[1] and known.get("shift_phase") == 0.0 and lasts_s >= limits.settled_s and is_driven
    if not is_held or not 1 <= gear <= len(limits.input_output_ratios):
        return
    clutch = clutch_of_gear(gear)
    yield from _pressure_samples(clutch, known, limits)
    shaft_rad_s = known.get("output_speed_rad_s", 0.0) * limits.input_output_ratios[gear - 1]
    is_speed_odd = _is_speed_odd(clutch, shaft_rad_s, known, limits)
    if is_speed_odd is not None:
        yield _sample("P0716", is_failed=is_speed_odd)
    if is_speed_odd:  # slip and ratio are made of it
        return
    slip, torque = known.get(f"clutch{clutch}_slip_rad_s"), known.get("engine_torque_nm")
    if slip is not None and torque is not None and abs(torque) > limits.tested_torque_nm:
        yield _sample("P0811", is_failed=abs(slip) > limits.most_slip_rad_s)
    yield from _ratio_samples(gear, f"input{clutch}", known, limits)


def _is_speed_odd(clutch: int, expected_rad_s: float, known: Mapping[str, float], limits: MonitorLimits) -> bool | None:
    """Return whether hub or shaft is contradicted by all around it: engine, the other one, output; None: unknown."""
    engine, hub = known.get("engine_speed_rad_s"), known.get("hub_speed_rad_s")
    shaft, output = known.get(f"input{clutch}_speed_rad_s"), known.get("output_speed_rad_s")
    if engine is None or hub is None or shaft is None or output is None or output < limits.tested_output_rad_s:
        return None
    most = max(limits.most_speed_error_rad_s, limits.most_ratio_error * expected_rad_s)
    is_hub_odd = min(abs(hub - engine), abs(hub - shaft)) > most and abs(shaft - expected_rad_s) <= most
    is_shaft_odd = min(abs(shaft - hub), abs(shaft - expected_rad_s)) > most and abs(hub - expected_rad_s) <= most
    return is_hub_odd or is_shaft_odd


def _pressure_samples(clutch: int, known: Mapping[str, float], limits: MonitorLimits) -> Iterator[Sample]:
    commanded, reached = known.get(f"clutch{clutch}_pressure_command_pa"), _pressure_pa(known, clutch, limits)
    if commanded is not None and reached is not None and commanded > limits.tested_pressure_pa:
        is_stuck = reached < limits.stuck_off_ratio * commanded
        yield _sample(STUCK_OFF_CODES[clutch], is_failed=is_stuck)
        if not is_stuck:
            yield _sample("P0868", is_failed=reached < limits.least_pressure_ratio * commanded)
    idle = 3 - clutch
    wanted, present = known.get(f"clutch{idle}_pressure_command_pa"), _pressure_pa(known, idle, limits)
    if wanted is not None and present is not None:
        yield _sample(STUCK_ON_CODES[idle], is_failed=present > wanted + limits.most_pressure_excess_pa)


def _ratio_samples(gear: int, name: str, known: Mapping[str, float], limits: MonitorLimits) -> Iterator[Sample]:
    shaft, output = known.get(f"{name}_speed_rad_s"), known.get("output_speed_rad_s")
    if shaft is None or output is None or output < limits.tested_output_rad_s:
        return
    error = shaft / output / limits.input_output_ratios[gear - 1] - 1.0
    is_failed = abs(error) > limits.most_ratio_error
    yield _sample(RATIO_CODES[gear - 1], is_failed=is_failed)
