"""Monitors: what the controller senses becomes results of tests, one sample of each at a time.

A monitor yields no sample where its test is not valid: while a gear changes, in a launch, at low torque, or without a
value that it needs. The trouble memory turns samples into failures.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from clutch_model.calibration import clutch_of_gear
from ecu_emulator.scenario.faults import SILENCE
from workshop.controller.clutches import Pack, heated_k, packs_of
from workshop.controller.descriptions import Values
from workshop.controller.memory import TestResult

Sample = tuple[str, TestResult]  # a trouble code as scan tools show it, and the sample


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorLimits:
    """When a sample counts as failed; a sound drive stays well within, as tests hold."""

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
    most_held_excess_pa: float = 0.75e5  # of a closed clutch; a biased sensor adds as much as when open
    least_zero_pa: float = -0.4e5  # of one without command; noise stays above -0.2 bar
    believed_samples: int = 5  # consecutive wrong pressures that count: transients are shorter
    pressures_pa: tuple[float, float] = (-0.5e5, 35.0e5)  # the sensor's range
    most_fluid_k: float = 393.15  # 120 degC
    fluid_range_k: tuple[float, float] = (233.15, 443.15)
    most_fluid_rate_k_s: float = 3.0
    warming_coolant_k: float = 30.0  # rise of the coolant since the start after which the fluid must have changed
    least_fluid_change_k: float = 2.0
    most_speed_error_rad_s: float = 10.0  # between sensors of shafts that turn together
    longest_shift_s: float = 3.0
    has_converter: bool = False  # with a lock-up clutch in place of two clutches
    lockup_settled_s: float = 0.7  # since gear, state of the lock-up clutch, and engine that pulls or not are the same
    tested_lockup_pa: float = 1.0e5
    most_held_slip_rad_s: float = 15.0  # of one that shall be locked
    most_led_slip_rad_s: float = 30.0  # of one with a target of 20 to 60 rpm; shudder stays below 20 rad/s
    least_open_slip_rad_s: float = 1.0  # of a converter that passes the tested torque
    most_clutch_k: float = 423.15  # 150 degC, of a pack as the controller computes it


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureErrors:
    """Last errors of one clutch's pressure, closed and open, each with the number of consecutive samples.

    Errors are -2, almost no pressure; -1, too little; 0, right; 1, too much; None: no sample.
    """

    held: tuple[int | None, int] = (None, 0)
    open: tuple[int | None, int] = (None, 0)

    def with_sample(self, error: int, *, is_held: bool) -> "PressureErrors":
        """Return the same after one more sample."""
        last, count = self.held if is_held else self.open
        sample = (error, count + 1 if error == last else 1)
        return replace(self, held=sample) if is_held else replace(self, open=sample)

    def believed(self, limits: MonitorLimits) -> tuple[int | None, int | None]:
        """Return the errors of the closed and the open clutch; 0 while a wrong pressure is not believed yet."""
        held, opened = (
            0 if error and count < limits.believed_samples else error for error, count in (self.held, self.open)
        )
        return held, opened

    def is_sensor_biased(self, limits: MonitorLimits) -> bool:
        """Whether it reads an impossible pressure when open, or wrong ones both closed and open."""
        held, opened = self.believed(limits)
        return opened == -1 or bool(held and opened)


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureCodes:
    """Trouble codes of one clutch's pressure."""

    sensor: str
    stuck_off: str
    stuck_on: str
    low: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorState:
    """The state of all monitors between samples."""

    t_s: float | None = None
    gears: tuple[float, float] = (0.0, 0.0)  # current, target
    since_s: float = 0.0  # time of their last change
    fluid_k: float | None = None
    fluid_s: float = 0.0
    fluids_k: tuple[float, float] | None = None  # coldest and warmest in this operation cycle
    start_coolant_k: float | None = None  # as this operation cycle began
    lockup_state: tuple[float | None, bool] = (None, False)  # and whether the engine pulls
    lockup_since_s: float = 0.0  # time of its last change
    clutches_k: tuple[float, float] | None = None  # as the controller computes them
    pressures: Mapping[str, PressureErrors] = field(default_factory=dict)  # by clutch


SENSED: Final = (
    "current_gear", "sump_temperature_k", "clutch1_pressure_pa", "hub_speed_rad_s", "output_speed_rad_s",
)  # fmt: skip
SENSED_OF_CONVERTER: Final = ("current_gear", "sump_temperature_k", "lockup_pressure_pa", "turbine_speed_rad_s")
"""One quantity of every message of the controller's sensors: until all were sent, a missing value is no fault."""

NOMINAL_LIMITS: Final = MonitorLimits()
LOCKUP_OPEN, LOCKUP_SLIPPING, LOCKUP_LOCKED = 0.0, 2.0, 3.0  # of the states of a lock-up clutch
IN_GEAR: Final = 0.0  # of the drive states
WARM_COOLANT_K: Final = 344.15  # 71 degC, where a warm-up cycle of OBD ends
WARMED_BY_K: Final = 22.2  # 40 degF, least rise in a warm-up cycle of OBD
PRESSURE_CODES: Final = {  # by clutch
    "clutch1": PressureCodes(sensor="P0841", stuck_off="P0746", stuck_on="P0747", low="P0868"),
    "clutch2": PressureCodes(sensor="P0846", stuck_off="P0776", stuck_on="P0777", low="P0868"),
    "lockup": PressureCodes(sensor="P0841", stuck_off="P2757", stuck_on="P2758"),
}
RATIO_CODES: Final = ("P0731", "P0732", "P0733", "P0734", "P0735", "P0729", "P076F", "P07D9")  # by gear
LOST_CODES: Final = {"ECM": "U0100", "ABS": "U0121", "IC": "U0155"}  # by sender
_SHAFT_SPEEDS: Final = ("hub_speed_rad_s", "input1_speed_rad_s", "input2_speed_rad_s")


def judge(
    watch: MonitorState, values: Values, t_s: float, limits: MonitorLimits = NOMINAL_LIMITS
) -> tuple[MonitorState, tuple[Sample, ...]]:
    """Return the state of the monitors and their samples at this moment; called about ten times a second.

    Parameters
    ----------
    watch
        State before.
    values
        Sensed values, in SI; those that are not available are missing.
    t_s
        Monotonic time [s].
    limits
        When a sample fails.
    """
    known = {name: value for name, value in values.items() if isinstance(value, int | float)}
    gears = (known.get("current_gear", 0.0), known.get("target_gear", 0.0))
    since_s = watch.since_s if gears == watch.gears and watch.t_s is not None else t_s
    is_pulling = known.get("engine_torque_nm", 0.0) > limits.tested_torque_nm
    lockup_state = (known.get("lockup_state"), is_pulling)
    lockup_since_s = watch.lockup_since_s if lockup_state == watch.lockup_state else t_s
    lasts_s = (t_s - since_s, t_s - lockup_since_s)
    pressures = {**watch.pressures, **dict(_pressure_errors(watch.pressures, gears, known, lasts_s, limits))}
    samples = (
        *_lost_samples(known),
        *_fluid_samples(watch, known, t_s, limits),
        *_shift_samples(gears, lasts_s[0], limits),
        *_pressure_samples(watch.pressures, pressures, known, limits),
        *(
            _converter_samples(gears, known, lasts_s, limits)
            if limits.has_converter
            else _clutch_samples(gears, known, lasts_s[0], limits)
        ),
    )
    fluid_k = known.get("sump_temperature_k")
    is_oil_believed = ("P0711", TestResult.PREPASSED) in samples and not limits.has_converter
    since_last_s = 0.0 if watch.t_s is None else max(0.0, t_s - watch.t_s)
    clutches_k = heated_k(watch.clutches_k, known, since_last_s, limits.packs) if is_oil_believed else watch.clutches_k
    after = MonitorState(
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
        pressures=pressures,
    )
    return after, (*samples, *(_heat_samples(clutches_k, samples, limits) if is_oil_believed else ()))


def is_warm(watch: MonitorState, values: Values) -> bool:
    """Return whether this is a warm-up cycle of OBD, which counts for ageing."""
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


def _fluid_samples(
    watch: MonitorState, known: Mapping[str, float], t_s: float, limits: MonitorLimits
) -> Iterator[Sample]:
    """Judge the sensor of the fluid's temperature, then, if it is plausible, the temperature."""
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


def _is_frozen(watch: MonitorState, known: Mapping[str, float], limits: MonitorLimits) -> bool:
    """Return whether the fluid's temperature has stayed the same while the engine warmed up."""
    coolant_k, fluids_k = known.get("coolant_temperature_k"), _widened(watch.fluids_k, known.get("sump_temperature_k"))
    if coolant_k is None or watch.start_coolant_k is None or fluids_k is None:
        return False
    has_warmed = coolant_k - watch.start_coolant_k >= limits.warming_coolant_k
    return has_warmed and fluids_k[1] - fluids_k[0] < limits.least_fluid_change_k


def _clutch_samples(
    gears: tuple[float, float], known: Mapping[str, float], lasts_s: float, limits: MonitorLimits
) -> Iterator[Sample]:
    yield _sample("P0715", is_failed=any(known.get(name) is None for name in _SHAFT_SPEEDS))
    if _is_held(gears, known, lasts_s, limits):
        yield from _gear_samples(int(gears[0]), known, limits)


def _converter_samples(
    gears: tuple[float, float], known: Mapping[str, float], last_s: tuple[float, float], limits: MonitorLimits
) -> Iterator[Sample]:
    """Judge a lock-up clutch and the ratio behind its converter; ``last_s``: time since gear and clutch changed [s]."""
    state = known.get("lockup_state")
    yield _sample("P0715", is_failed=known.get("turbine_speed_rad_s") is None)
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


def _pressure_pa(known: Mapping[str, float], clutch: str, limits: MonitorLimits) -> float | None:
    """Return a clutch pressure [Pa], None if it is missing or outside the sensor's range."""
    pressure_pa, (low_pa, high_pa) = known.get(f"{clutch}_pressure_pa"), limits.pressures_pa
    return pressure_pa if pressure_pa is not None and low_pa <= pressure_pa <= high_pa else None


def _pressure_errors(
    before: Mapping[str, PressureErrors],
    gears: tuple[float, float],
    known: Mapping[str, float],
    lasts_s: tuple[float, float],
    limits: MonitorLimits,
) -> Iterator[tuple[str, PressureErrors]]:
    """Yield the clutches whose command has settled, with their pressure sampled."""
    held = None if limits.has_converter else f"clutch{clutch_of_gear(int(gears[0]))}"
    least_pa = limits.tested_lockup_pa if limits.has_converter else limits.tested_pressure_pa
    if limits.has_converter:
        is_settled = lasts_s[1] >= limits.lockup_settled_s
    else:
        is_settled = _is_held(gears, known, lasts_s[0], limits)
    for clutch in _clutches(limits) if is_settled else ():
        command, sensed = known.get(f"{clutch}_pressure_command_pa"), known.get(f"{clutch}_pressure_pa")
        if command is None or sensed is None:
            continue
        if is_held := command > least_pa and held in {None, clutch}:
            is_low, is_off = sensed < limits.least_pressure_ratio * command, sensed < limits.stuck_off_ratio * command
            error = -is_low - is_off or int(sensed > command + limits.most_held_excess_pa)
        elif clutch != held:
            error = int(sensed > command + limits.most_pressure_excess_pa) - (sensed < limits.least_zero_pa)
        else:
            continue
        yield clutch, before.get(clutch, PressureErrors()).with_sample(error, is_held=is_held)


def _pressure_samples(
    before: Mapping[str, PressureErrors],
    after: Mapping[str, PressureErrors],
    known: Mapping[str, float],
    limits: MonitorLimits,
) -> Iterator[Sample]:
    """Judge sensors and pressures: an error in only one of the states, closed or open, is one of the pressure.

    It is judged in the next other state, where a biased sensor would show an error, too.
    """
    for clutch in _clutches(limits):
        codes, errors = PRESSURE_CODES[clutch], after.get(clutch, PressureErrors())
        is_biased = errors.is_sensor_biased(limits)
        yield _sample(codes.sensor, is_failed=is_biased or _pressure_pa(known, clutch, limits) is None)
        last = before.get(clutch, PressureErrors())
        if is_biased or errors is last:
            continue
        held, opened = errors.believed(limits)
        if errors.held is not last.held and errors.held[0] == 0:
            yield _sample(codes.stuck_off, is_failed=False)
            if codes.low is not None and all(other.believed(limits)[0] != -1 for other in after.values()):
                yield _sample(codes.low, is_failed=False)
            if opened is not None:
                yield _sample(codes.stuck_on, is_failed=opened > 0)
        elif errors.open is not last.open and errors.open[0] == 0:
            yield _sample(codes.stuck_on, is_failed=False)
            if held == -2:
                yield _sample(codes.stuck_off, is_failed=True)
            elif held == -1 and codes.low is not None:
                yield _sample(codes.low, is_failed=True)


def _clutches(limits: MonitorLimits) -> tuple[str, ...]:
    return ("lockup",) if limits.has_converter else ("clutch1", "clutch2")


def _heat_samples(
    clutches_k: tuple[float, float] | None, samples: tuple[Sample, ...], limits: MonitorLimits
) -> Iterator[Sample]:
    """Judge the clutches' temperature while the pressure sensors are plausible."""
    sensors = {codes.sensor for codes in PRESSURE_CODES.values()}
    if clutches_k is not None and not any((code, TestResult.PREFAILED) in samples for code in sensors):
        yield _sample("P2787", is_failed=max(clutches_k) > limits.most_clutch_k)


def _shift_samples(gears: tuple[float, float], lasts_s: float, limits: MonitorLimits) -> Iterator[Sample]:
    current, target = gears
    if current and target and current != target and lasts_s > limits.longest_shift_s:
        yield _sample("P0780", is_failed=True)
    elif current and current == target:
        yield _sample("P0780", is_failed=False)


def _is_held(gears: tuple[float, float], known: Mapping[str, float], lasts_s: float, limits: MonitorLimits) -> bool:
    """Return whether a gear has been engaged for long enough to be judged."""
    is_driven = known.get("drive_state", IN_GEAR) == IN_GEAR  # the shift cycle sends no drive state
    is_steady = gears[0] == gears[1] and known.get("shift_phase") == 0.0 and lasts_s >= limits.settled_s
    return is_steady and is_driven and 1 <= gears[0] < len(limits.input_output_ratios) + 1


def _gear_samples(gear: int, known: Mapping[str, float], limits: MonitorLimits) -> Iterator[Sample]:
    """Judge clutch and ratio of an engaged gear."""
    clutch = clutch_of_gear(gear)
    shaft_rad_s = known.get("output_speed_rad_s", 0.0) * limits.input_output_ratios[gear - 1]
    is_speed_odd = _is_speed_odd(clutch, shaft_rad_s, known, limits)
    if is_speed_odd is not None:
        yield _sample("P0716", is_failed=is_speed_odd)
    if is_speed_odd:  # slip and ratio depend on it
        return
    slip, torque = known.get(f"clutch{clutch}_slip_rad_s"), known.get("engine_torque_nm")
    if slip is not None and torque is not None and abs(torque) > limits.tested_torque_nm:
        yield _sample("P0811", is_failed=abs(slip) > limits.most_slip_rad_s)
    yield from _ratio_samples(gear, f"input{clutch}", known, limits)


def _is_speed_odd(clutch: int, expected_rad_s: float, known: Mapping[str, float], limits: MonitorLimits) -> bool | None:
    """Return whether hub or shaft speed contradicts all of engine, the other one and output; None: unknown."""
    engine, hub = known.get("engine_speed_rad_s"), known.get("hub_speed_rad_s")
    shaft, output = known.get(f"input{clutch}_speed_rad_s"), known.get("output_speed_rad_s")
    if engine is None or hub is None or shaft is None or output is None or output < limits.tested_output_rad_s:
        return None
    most = max(limits.most_speed_error_rad_s, limits.most_ratio_error * expected_rad_s)
    is_hub_odd = min(abs(hub - engine), abs(hub - shaft)) > most and abs(shaft - expected_rad_s) <= most
    is_shaft_odd = min(abs(shaft - hub), abs(shaft - expected_rad_s)) > most and abs(hub - expected_rad_s) <= most
    return is_hub_odd or is_shaft_odd


def _ratio_samples(gear: int, name: str, known: Mapping[str, float], limits: MonitorLimits) -> Iterator[Sample]:
    shaft, output = known.get(f"{name}_speed_rad_s"), known.get("output_speed_rad_s")
    if shaft is None or output is None or output < limits.tested_output_rad_s:
        return
    error = shaft / output / limits.input_output_ratios[gear - 1] - 1.0
    is_failed = abs(error) > limits.most_ratio_error
    yield _sample(RATIO_CODES[gear - 1], is_failed=is_failed)
