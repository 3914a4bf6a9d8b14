"""Signals held against each other: what the torque balance alone would take for friction.

A sensor that lies changes the balance, and chi-square sees that, unless another friction would explain it as well: a
pressure that reads too low, a slip that reads too high. No check here needs friction. `agreement` looks at the samples
of any vehicle, over a whole shift; `plausibility_faults` at the aligned signals of the torque balance, in its slip
window and moment by moment.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array
from canlog.jit import kernel
from canlog.series import Series
from clutch_model.gears import clutch_of_gear
from diag_service.diagnosis.alignment import COMMAND_LAG_S, GRID_S, NS_TO_S, AlignedSignals
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Columns, Signal
from diag_service.diagnosis.events import EndReason, Event, EventKind
from diag_service.diagnosis.quality.limits import LIMITS, QualityLimits
from diag_service.diagnosis.records import Reason

_LAG_NS: Final = round(COMMAND_LAG_S / NS_TO_S)
_LEAST: Final = 0.0  # what a sensor of pressure or speed cannot show less of: it repeats that with reason
_STD_OF_SECOND_DIFFERENCE: Final = 1.4826 / math.sqrt(6.0)  # of white noise, over the median of their sizes
_ROUNDING: Final = 1e-6  # of a variance: far above what doubles lose, far below what a measurement tells
_SHAFT_GEARS: Final = (Signal.INPUT1_GEAR, Signal.INPUT2_GEAR)
_WITHOUT_LOCK: Final = frozenset({EventKind.CREEP, EventKind.REGEAR})  # a car may stop first; both clutches are open
_WHEELS: Final = (Signal.WHEEL_FL_SPEED, Signal.WHEEL_FR_SPEED, Signal.WHEEL_RL_SPEED, Signal.WHEEL_RR_SPEED)
_PRESSURES: Final = (
    (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH1_PRESSURE_COMMAND),
    (Signal.CLUTCH2_PRESSURE, Signal.CLUTCH2_PRESSURE_COMMAND),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureZeros:
    """What is known of the zeros of both pressure sensors: reading minus truth on an empty clutch."""

    mean_pa: FloatArray  # (2,)
    variance_pa2: FloatArray  # (2,)


@dataclass(frozen=True, slots=True, kw_only=True)
class SlippingClutch:
    """The on-coming clutch of a shift, as far as its signals can be held against each other."""

    number: int  # 1 or 2
    rows: slice  # of the grid, in which it alone is loaded and slips
    pressure_zero_pa: float  # what its pressure sensor reads without pressure
    touch_pressure_pa: float  # below it the return springs hold the pressure, whatever is commanded


def agreement(event: Event, limits: QualityLimits = LIMITS) -> float | None:
    """Return how well sensors agree that must, 0 to 1; the worst pair counts, None if there is no pair."""
    columns = event.columns
    # With both clutches open nothing is asked of them, and a piston that returns holds the pressure of its spring.
    pressures = None if event.kind is EventKind.REGEAR else _pressures(columns, limits)
    judged = (_wheels(event, limits), _hub(columns, limits), pressures)
    return min((value for value in judged if value is not None), default=None)


def plausibility_faults(
    event: Event, signals: AlignedSignals, clutch: SlippingClutch, limits: QualityLimits = LIMITS
) -> tuple[Reason, ...]:
    """Return why the signals of a shift, once put on one clock, cannot all be true; empty if they can."""
    found = {
        Reason.SENSOR_FROZEN: any(is_frozen(event.columns[one], one, limits) for one in BALANCE_SIGNALS),
        Reason.SPEEDS_DISAGREE: speed_gap_rad_s(event, signals, clutch, limits) > limits.speeds_rad_s
        or hub_gap_rad_s(signals, limits) > hub_limit_rad_s(event, limits),
        Reason.PRESSURE_OFF_COMMAND: _misses_command(signals, clutch, limits),
    }
    return tuple(reason for reason, is_found in found.items() if is_found)


def zero_has_jumped(known: PressureZeros, measured: PressureZeros, limits: QualityLimits = LIMITS) -> bool:
    """Return whether the zero of a pressure sensor, measured on an empty clutch, contradicts what was known of it.

    ``measured`` is what is known with the measurement, ``known`` without. A zero moves by its update, and the variance
    of the update is what the variance of the zero loses.
    """
    moved_pa = measured.mean_pa - known.mean_pa
    # A zero that was not measured moves a little with the other one; rounding must not make that a contradiction.
    variance = np.maximum(known.variance_pa2 - measured.variance_pa2, _ROUNDING * known.variance_pa2)
    return bool(np.any(moved_pa**2 > limits.zero_gate * variance))


def compile_plausibility() -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    _longest_run(np.zeros(2))
    _noise_in_steps(np.zeros(2), 0, 1)


def is_frozen(series: Series, signal: Signal, limits: QualityLimits = LIMITS) -> bool:
    """Return whether a signal repeats one value longer than its own noise and resolution explain.

    How often neighbours are equal elsewhere in the signal says how likely a repetition is. Of a signal without noise it
    says nothing: it may well rest.
    """
    value = np.ascontiguousarray(series.value)
    run_count, first, longest = _longest_run(value)
    if signal is not Signal.ENGINE_TORQUE and value[first] <= _LEAST:
        return False
    if _noise_in_steps(value, first, first + longest) < limits.least_noise_steps:
        return False
    others = len(value) - longest
    repeats = others - (run_count - 1)
    share = (repeats + 1.0) / (others + 2.0)
    return longest > 1.0 + math.log(limits.repeats_chance / len(value)) / math.log(share)


@kernel
def _longest_run(value: FloatArray) -> tuple[int, int, int]:
    """Return how many runs of one value there are, where the first of the longest begins, and how long it is."""
    run_count, first, longest, begin = 1, 0, 1, 0
    for row in range(1, len(value) + 1):
        if row < len(value) and value[row] == value[row - 1]:
            continue
        if row - begin > longest:
            first, longest = begin, row - begin
        begin = row
        run_count += row < len(value)
    return run_count, first, longest


@kernel
def _noise_in_steps(value: FloatArray, first: int, stop: int) -> float:
    """Return the noise of all but some rows in steps of its resolution, by its second differences; inf if too few."""
    rest = np.concatenate((value[:first], value[stop:]))
    steps = rest[1:] - rest[:-1]
    least = np.inf
    for step in np.abs(steps):
        if 0.0 < step < least:
            least = step
    if len(steps) < 3 or least == np.inf:
        return np.inf
    return float(np.median(np.abs(steps[1:] - steps[:-1])) * _STD_OF_SECOND_DIFFERENCE / least)


def speed_gap_rad_s(
    event: Event, signals: AlignedSignals, clutch: SlippingClutch, limits: QualityLimits = LIMITS
) -> float:
    """Return the largest mean difference [rad/s] between speeds that must agree.

    Hub and input shaft of the clutch that is locked before a change of gears, and of the one that is locked at the end;
    both input shafts up to their ratio, as long as each keeps its gear.
    """
    end_s = (event.end_ns - event.start_ns) * NS_TO_S
    grid_s = signals.grid_s
    gaps = [shaft_gap_rad_s(signals, rows, limits) for rows in geared_stretches(event, grid_s, clutch, limits)]
    if event.from_gear != event.to_gear and event.kind is not EventKind.REGEAR:
        locked = signals.slip_rad_s(clutch_of_gear(event.from_gear))
        gaps.append(abs(float(np.mean(locked[grid_s < grid_s[0] + limits.locked_s]))))
    if event.kind not in _WITHOUT_LOCK and event.end_reason is EndReason.COMPLETE:
        closed = signals.slip_rad_s(clutch_of_gear(event.to_gear))[grid_s >= end_s - limits.locked_s]
        gaps.append(0.0 if _is_settling(closed, limits) else abs(float(np.mean(closed))))
    return max(gaps, default=0.0)


def _is_settling(slip_rad_s: FloatArray, limits: QualityLimits) -> bool:
    """Return whether a clutch still slips, as in a coast change; what a sensor reads too much changes less fast."""
    middle = len(slip_rad_s) // 2
    change_rad_s = float(np.mean(slip_rad_s[middle:]) - np.mean(slip_rad_s[:middle]))
    return abs(change_rad_s) > limits.settling_rad_s


def hub_gap_rad_s(signals: AlignedSignals, limits: QualityLimits = LIMITS) -> float:
    """Return the largest mean difference [rad/s] between engine and hub, which a torsion damper ties together."""
    during = signals.grid_s >= 0.0  # before a launch the engine may be started
    return _largest_mean((signals.engine_speed.on_grid - signals.hub_speed.on_grid)[during], limits.speeds_mean_s)


def hub_limit_rad_s(event: Event, limits: QualityLimits = LIMITS) -> float:
    """Return how far engine and hub may be apart [rad/s] in an event."""
    return limits.speeds_rad_s if event.from_gear != event.to_gear else limits.launch_speeds_rad_s


def geared_stretches(
    event: Event, grid_s: FloatArray, clutch: SlippingClutch, limits: QualityLimits = LIMITS
) -> list[slice]:
    """Return the stretches of the grid in which each input shaft keeps its gear.

    Where the shafts say their gears, what is near a new one is left out: the shaft rings, and its message may be late.
    Where they do not, they stand in gear from a moment before the slip window on.
    """
    gears = [event.columns.get(signal) for signal in _SHAFT_GEARS]
    first, second = gears
    if first is None or second is None:
        return [slice(max(0, clutch.rows.start - round(limits.in_gear_s / GRID_S)), len(grid_s))]
    origin_ns = event.start_ns
    held = np.column_stack([_held(series, grid_s, origin_ns) for series in (first, second)])
    edges = np.flatnonzero((held[1:] != held[:-1]).any(axis=1)) + 1
    ringing = round(limits.ringing_s / GRID_S)
    starts = [0, *(edges + ringing).tolist()]
    stretches = zip(starts, [*(edges - ringing).tolist(), len(grid_s)], strict=True)
    least = round(limits.speeds_mean_s / GRID_S)
    return [slice(start, stop) for start, stop in stretches if stop - start >= least and (held[start] > 0.0).all()]


def _held(series: Series, grid_s: FloatArray, origin_ns: int) -> FloatArray:
    """Return the value in force at each point of the grid; the first one before its time."""
    times_s = (series.t_ns - origin_ns) * NS_TO_S
    return series.value[np.maximum(np.searchsorted(times_s, grid_s, side="right") - 1, 0)]


def shaft_gap_rad_s(signals: AlignedSignals, rows: slice, limits: QualityLimits = LIMITS) -> float:
    """Return how far both input shafts are apart [rad/s], up to the ratio of their gears."""
    first, second = (speed.on_grid[rows] for speed in signals.input_speed)
    is_turning = second > limits.turning_rad_s  # at a standstill there is no ratio
    if not is_turning.any():
        return 0.0
    ratio = float(np.median(first[is_turning] / second[is_turning]))
    return _largest_mean(first - ratio * second, limits.speeds_mean_s)


def _misses_command(signals: AlignedSignals, clutch: SlippingClutch, limits: QualityLimits) -> bool:
    """Return whether the slipping clutch's pressure is not the commanded one; False without a command.

    A piston on its way is held against nothing: its spring sets the pressure, whatever is commanded.
    """
    expected_pa = signals.expected_pa[clutch.number - 1]
    if expected_pa is None:
        return False
    read_pa = signals.pressure[clutch.number - 1].on_grid - clutch.pressure_zero_pa
    has_arrived = _has_arrived(read_pa[clutch.rows], expected_pa[clutch.rows], clutch.touch_pressure_pa, limits)
    if np.count_nonzero(has_arrived) * GRID_S < limits.pressure_mean_s:
        return False
    error_pa = np.maximum(read_pa, clutch.touch_pressure_pa) - np.maximum(expected_pa, clutch.touch_pressure_pa)
    following_pa = np.abs(np.gradient(expected_pa, GRID_S)) * COMMAND_LAG_S  # what the command is still ahead
    beyond_pa = np.sign(error_pa) * np.maximum(np.abs(error_pa) - limits.following_ratio * following_pa, 0.0)
    error_pa, beyond_pa, judged_pa = (one[clutch.rows] for one in (error_pa, beyond_pa, expected_pa))
    by_clock_pa = limits.command_clock_s * abs(float(judged_pa[-1] - judged_pa[0])) / (len(judged_pa) * GRID_S)
    return bool(
        abs(float(np.mean(error_pa[has_arrived]))) > limits.pressure_window_pa + by_clock_pa
        or _largest_mean(np.where(has_arrived, beyond_pa, 0.0), limits.pressure_mean_s) > limits.pressure_moment_pa
    )


def _has_arrived(read_pa: FloatArray, expected_pa: FloatArray, touch_pa: float, limits: QualityLimits) -> BoolArray:
    """Return where a piston presses: not on its way, nor its pressure still rising to the command behind it."""
    has_arrived: BoolArray = read_pa > touch_pa + limits.travel_pa
    starts = np.flatnonzero(np.diff(has_arrived.astype(np.int8), prepend=1) > 0)
    longest = round(limits.catching_up_s / GRID_S)
    for start in starts.tolist():
        is_behind = expected_pa[start : start + longest] - read_pa[start : start + longest] > limits.pressure_window_pa
        caught_up = np.flatnonzero(~is_behind)
        has_arrived[start : start + (int(caught_up[0]) if len(caught_up) else longest)] = False
    return has_arrived


def _largest_mean(values: FloatArray, span_s: float) -> float:
    """Return the largest magnitude of the running mean over a span of the grid."""
    count = min(round(span_s / GRID_S), len(values))
    total = np.cumsum(np.insert(values, 0, 0.0))
    return float(np.max(np.abs(total[count:] - total[:-count])) / count)


def _wheels(event: Event, limits: QualityLimits) -> float | None:
    """Compare wheel speeds with the speed of the transmission output: their ratio is one number.

    While a shaft rings in its new gear, so does the output: that tells nothing of the sensors.
    """
    columns = event.columns
    output = columns.get(Signal.OUTPUT_SPEED)
    if output is None or not len(output.t_ns):
        return None
    ratios = []
    for wheel in (columns[signal] for signal in _WHEELS if signal in columns):
        turning = _at(output, wheel)
        is_fast = (wheel.value > limits.least_wheel_m_s) & (turning > 0.0) & ~_is_ringing(event, wheel.t_ns, limits)
        if is_fast.any():
            ratios.append(wheel.value[is_fast] / turning[is_fast])
    if not ratios:
        return None
    middle = float(np.median(np.concatenate(ratios)))
    return limits.wheel_ratio.score(max(float(np.sqrt(np.mean((ratio / middle - 1.0) ** 2))) for ratio in ratios))


def _is_ringing(event: Event, t_ns: Int64Array, limits: QualityLimits) -> BoolArray:
    """Return at which times a shaft swings that has a new gear, as far as it says so."""
    is_ringing = np.zeros(len(t_ns), np.bool_)
    for gear in (event.columns[signal] for signal in _SHAFT_GEARS if signal in event.columns):
        for change_ns in gear.t_ns[1:][np.diff(gear.value) != 0.0].tolist():
            is_ringing |= np.abs(t_ns - change_ns) * NS_TO_S <= limits.ringing_s
    return is_ringing


def _hub(columns: Columns, limits: QualityLimits) -> float | None:
    """Compare engine and clutch hub."""
    engine, hub = columns.get(Signal.ENGINE_SPEED), columns.get(Signal.HUB_SPEED)
    if engine is None or hub is None or not len(engine.t_ns) or not len(hub.t_ns):
        return None
    return limits.hub_mean_rad_s.score(abs(float(np.mean(engine.value - _at(hub, engine)))))


def _pressures(columns: Columns, limits: QualityLimits) -> float | None:
    """Compare clutch pressures with what was commanded a moment before."""
    differences_pa = [
        float(np.median(np.abs(pressure.value - _at(command, pressure, _LAG_NS))))
        for read, commanded in _PRESSURES
        for pressure, command in ((columns.get(read), columns.get(commanded)),)
        if pressure is not None and command is not None and len(pressure.t_ns) and len(command.t_ns)
    ]
    return limits.pressure_median_pa.score(max(differences_pa)) if differences_pa else None


def _at(series: Series, other: Series, lag_ns: int = 0) -> FloatArray:
    """Return one signal at the times of another, or ``lag_ns`` before them."""
    origin_ns = int(series.t_ns[0])
    asked = (other.t_ns - origin_ns - lag_ns).astype(np.float64)
    return np.interp(asked, (series.t_ns - origin_ns).astype(np.float64), series.value)
