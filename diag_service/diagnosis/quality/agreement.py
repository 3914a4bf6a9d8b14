"""How well sensors agree that must, over the samples of a whole shift: no balance of torques is needed for it."""

import math
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from canlog.jit import array_kernel, inlined_kernel
from canlog.series import Series
from diag_service.diagnosis.alignment import COMMAND_LAG_S, NS_TO_S
from diag_service.diagnosis.columns import Columns, Signal
from diag_service.diagnosis.events import Event, EventKind
from diag_service.diagnosis.quality.averages import compile_averages, mean, median
from diag_service.diagnosis.quality.limits import LIMITS, QualityLimits

SHAFT_GEARS: Final = (Signal.INPUT1_GEAR, Signal.INPUT2_GEAR)
_LAG_NS: Final = round(COMMAND_LAG_S / NS_TO_S)
_NEVER: Final = np.empty(0, np.int64)
_WHEELS: Final = (Signal.WHEEL_FL_SPEED, Signal.WHEEL_FR_SPEED, Signal.WHEEL_RL_SPEED, Signal.WHEEL_RR_SPEED)
_PRESSURES: Final = (
    (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH1_PRESSURE_COMMAND),
    (Signal.CLUTCH2_PRESSURE, Signal.CLUTCH2_PRESSURE_COMMAND),
)


def agreement(event: Event, limits: QualityLimits = LIMITS) -> float | None:
    """Return how well sensors agree that must, 0 to 1; the worst pair counts, None if there is no pair."""
    columns = event.columns
    # With both clutches open nothing is asked of them, and a piston that returns holds the pressure of its spring.
    pressures = None if event.kind is EventKind.REGEAR else _pressures(columns, limits)
    judged = (_wheels(event, limits), _hub(columns, limits), pressures)
    return min((value for value in judged if value is not None), default=None)


def compile_agreement() -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    one = Series(t_ns=np.zeros(1, np.int64), sequence=np.zeros(1, np.int64), value=np.zeros(1))
    _divide(one.t_ns, one.value, one.t_ns, one.value, _NEVER, 0.0, 0.0, np.empty(1), 0)
    _apart(one, one)
    _worst_spread(one.value, 1.0, one.t_ns)
    compile_averages()


def _wheels(event: Event, limits: QualityLimits) -> float | None:
    """Compare wheel speeds with the speed of the transmission output: their ratio is one number.

    While a shaft rings in its new gear, so does the output: that tells nothing of the sensors.
    """
    columns = event.columns
    output = columns.get(Signal.OUTPUT_SPEED)
    if output is None or not len(output.t_ns):
        return None
    changes_ns = _gear_changes_ns(columns)
    wheels = [columns[signal] for signal in _WHEELS if signal in columns]
    ratios, ends = np.empty(sum(len(wheel.t_ns) for wheel in wheels)), [0]
    least_m_s, ringing_s = limits.least_wheel_m_s, limits.ringing_s
    for wheel in wheels:
        series = wheel.t_ns, wheel.value, output.t_ns, output.value
        ends.append(_divide(*series, changes_ns, least_m_s, ringing_s, ratios, ends[-1]))
    found = ratios[: ends[-1]]
    if not len(found):
        return None
    return limits.wheel_ratio.score(math.sqrt(_worst_spread(found, median(found), np.array(ends))))


def _gear_changes_ns(columns: Columns) -> Int64Array:
    """Return when a shaft says that it has a new gear, as far as one does."""
    gears = [columns[signal] for signal in SHAFT_GEARS if signal in columns]
    return np.concatenate([_NEVER, *(gear.t_ns[1:][np.diff(gear.value) != 0.0] for gear in gears)])


@array_kernel
def _divide(
    t_ns: Int64Array,
    wheel_m_s: FloatArray,
    output_ns: Int64Array,
    output_rad_s: FloatArray,
    changes_ns: Int64Array,
    least_m_s: float,
    ringing_s: float,
    ratios: FloatArray,
    first: int,
) -> int:
    """Fill in a wheel's speed over that of the output where both turn and no shaft rings; return where it ends."""
    stop, sample = first, 0
    for row in range(len(t_ns)):
        sample = _last_sample(output_ns, sample, t_ns[row])
        turning_rad_s = _reading(output_ns, output_rad_s, sample, t_ns[row])
        is_told = wheel_m_s[row] > least_m_s and turning_rad_s > 0.0
        for change_ns in changes_ns:
            is_told = is_told and abs(t_ns[row] - change_ns) * NS_TO_S > ringing_s
        if is_told:
            ratios[stop] = wheel_m_s[row] / turning_rad_s
            stop += 1
    return stop


@array_kernel
def _worst_spread(ratios: FloatArray, middle: float, ends: Int64Array) -> float:
    """Return the largest mean square by which the ratios of one wheel are off the middle, as a share of it."""
    worst = 0.0
    for wheel in range(len(ends) - 1):
        total = 0.0
        for row in range(ends[wheel], ends[wheel + 1]):
            total += (ratios[row] / middle - 1.0) ** 2
        worst = max(worst, total / max(ends[wheel + 1] - ends[wheel], 1))
    return worst


def _hub(columns: Columns, limits: QualityLimits) -> float | None:
    """Compare engine and clutch hub."""
    engine, hub = columns.get(Signal.ENGINE_SPEED), columns.get(Signal.HUB_SPEED)
    if engine is None or hub is None or not len(engine.t_ns) or not len(hub.t_ns):
        return None
    return limits.hub_mean_rad_s.score(abs(mean(_apart(engine, hub))))


def _pressures(columns: Columns, limits: QualityLimits) -> float | None:
    """Compare clutch pressures with what was commanded a moment before."""
    differences_pa = [
        median(np.abs(_apart(pressure, command, _LAG_NS)))
        for read, commanded in _PRESSURES
        for pressure, command in ((columns.get(read), columns.get(commanded)),)
        if pressure is not None and command is not None and len(pressure.t_ns) and len(command.t_ns)
    ]
    return limits.pressure_median_pa.score(max(differences_pa)) if differences_pa else None


def _apart(series: Series, other: Series, lag_ns: int = 0) -> FloatArray:
    """Return a signal less what another one read at its times, or ``lag_ns`` before them."""
    differences = np.empty(len(series.t_ns))
    _subtract(series.t_ns, series.value, other.t_ns, other.value, lag_ns, differences)
    return differences


@array_kernel
def _subtract(
    t_ns: Int64Array,
    value: FloatArray,
    other_ns: Int64Array,
    other: FloatArray,
    lag_ns: int,
    differences: FloatArray,
) -> None:
    sample = 0
    for row in range(len(t_ns)):
        at_ns = t_ns[row] - lag_ns
        sample = _last_sample(other_ns, sample, at_ns)
        differences[row] = value[row] - _reading(other_ns, other, sample, at_ns)


@inlined_kernel
def _last_sample(t_ns: Int64Array, sample: int, at_ns: int) -> int:
    """Return which sample was the last one at a time, from an earlier one on."""
    while sample < len(t_ns) - 1 and t_ns[sample + 1] <= at_ns:
        sample += 1
    return sample


@inlined_kernel
def _reading(t_ns: Int64Array, value: FloatArray, sample: int, at_ns: int) -> float:
    """Return what a signal reads after some sample: linear up to the next one, constant beyond both ends."""
    reading = float(value[sample])
    if sample < len(t_ns) - 1 and t_ns[sample] < at_ns:
        rise = (value[sample + 1] - value[sample]) / (t_ns[sample + 1] - t_ns[sample])
        reading += rise * (at_ns - t_ns[sample])
    return reading
