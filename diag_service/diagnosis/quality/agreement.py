"""How well sensors agree that must, over the samples of a whole shift: no balance of torques is needed for it."""

import math
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from canlog.jit import array_kernel
from canlog.series import Series
from diag_service.diagnosis.alignment import COMMAND_LAG_S, NS_TO_S, read_at
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
    _divide(one.t_ns, one.value, _at(one, one), _NEVER, 0.0, 0.0, np.empty(1), 0)
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
        turning = _at(output, wheel)
        ends.append(_divide(wheel.t_ns, wheel.value, turning, changes_ns, least_m_s, ringing_s, ratios, ends[-1]))
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
    output_rad_s: FloatArray,
    changes_ns: Int64Array,
    least_m_s: float,
    ringing_s: float,
    ratios: FloatArray,
    first: int,
) -> int:
    """Fill in a wheel's speed over that of the output where both turn and no shaft rings; return where it ends."""
    stop = first
    for row in range(len(t_ns)):
        is_told = wheel_m_s[row] > least_m_s and output_rad_s[row] > 0.0
        for change_ns in changes_ns:
            is_told = is_told and abs(t_ns[row] - change_ns) * NS_TO_S > ringing_s
        if is_told:
            ratios[stop] = wheel_m_s[row] / output_rad_s[row]
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
    return limits.hub_mean_rad_s.score(abs(mean(engine.value - _at(hub, engine))))


def _pressures(columns: Columns, limits: QualityLimits) -> float | None:
    """Compare clutch pressures with what was commanded a moment before."""
    differences_pa = [
        median(np.abs(pressure.value - _at(command, pressure, _LAG_NS)))
        for read, commanded in _PRESSURES
        for pressure, command in ((columns.get(read), columns.get(commanded)),)
        if pressure is not None and command is not None and len(pressure.t_ns) and len(command.t_ns)
    ]
    return limits.pressure_median_pa.score(max(differences_pa)) if differences_pa else None


def _at(series: Series, other: Series, lag_ns: int = 0) -> FloatArray:
    """Return one signal at the times of another, or ``lag_ns`` before them."""
    origin_ns = int(series.t_ns[0])
    return read_at(series, (other.t_ns - (origin_ns + lag_ns)).astype(np.float64), origin_ns, 1.0)
