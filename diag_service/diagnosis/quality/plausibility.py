"""Signals held against each other: what the torque balance alone would take for friction.

A sensor that lies changes the balance, and chi-square sees that, unless another friction would explain it as well: a
pressure that reads too low, a slip that reads too high. No check here needs friction. The aligned signals of the torque
balance are looked at in its slip window and moment by moment; what the samples of a whole shift say is in `agreement`.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Series
from clutch_model.calibration import Calibration, clutch_of_gear
from clutch_results.event_kinds import EndReason, EventKind
from clutch_results.records import Reason, ShiftEstimate, Status
from diag_service.diagnosis.alignment import COMMAND_LAG_S, GRID_S, NS_TO_S, AlignedSignals
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.quality.data_quality import LIMITS, SHAFT_GEARS, QualityLimits

_LEAST: Final = 0.0  # what a sensor of pressure or speed cannot show less of: it repeats that with reason
_STD_OF_SECOND_DIFFERENCE: Final = 1.4826 / math.sqrt(6.0)  # of white noise, over the median of their sizes
_ROUNDING: Final = 1e-6  # of a variance: far above what doubles lose, far below what a measurement tells
_WITHOUT_LOCK: Final = frozenset({EventKind.CREEP, EventKind.REGEAR})  # a car may stop first; both clutches are open
LEAST_RATIO, MOST_RATIO = 0.7, 1.25  # of the friction that the type has new: no fluid leaves these
SURE_STD: Final = 1.0
MOST_MISFITS: Final = 3  # without one event that fits
_MISFITS: Final = frozenset({Reason.MISFIT, Reason.SPEEDS_DISAGREE, Reason.IMPLAUSIBLE})


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


def plausibility_faults(
    event: Event, signals: AlignedSignals, clutch: SlippingClutch, limits: QualityLimits = LIMITS
) -> tuple[Reason, ...]:
    """Return why the signals of a shift, once put on one clock, cannot all be true; empty if they can."""
    apart_rad_s = signals.speeds_apart_rad_s
    is_change = event.from_gear != event.to_gear
    most_at_hub_rad_s = limits.speeds_rad_s if is_change else limits.launch_speeds_rad_s
    found = {
        Reason.SENSOR_FROZEN: any(is_frozen(event.columns[one], one, limits) for one in BALANCE_SIGNALS),
        Reason.SPEEDS_DISAGREE: speed_gap_rad_s(event, signals, clutch, limits) > limits.speeds_rad_s + apart_rad_s
        or hub_gap_rad_s(signals, limits) > most_at_hub_rad_s + apart_rad_s,
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


def is_frozen(series: Series, signal: Signal, limits: QualityLimits = LIMITS) -> bool:
    """Return whether a signal repeats one value longer than its own noise and resolution explain.

    How often neighbours are equal elsewhere in the signal says how likely a repetition is. Of a signal without noise it
    says nothing: it may well rest.
    """
    value = series.value
    edges = np.flatnonzero(np.diff(value, prepend=np.nan, append=np.nan) != 0.0)  # of runs of one value
    lengths = np.diff(edges)
    run_count, first, longest = len(lengths), int(edges[lengths.argmax()]), int(lengths.max())
    if signal is not Signal.ENGINE_TORQUE and value[first] <= _LEAST:
        return False
    others = len(value) - longest
    repeats = others - (run_count - 1)
    share = (repeats + 1.0) / (others + 2.0)
    if longest <= 1.0 + math.log(limits.repeats_chance / len(value)) / math.log(share):
        return False
    return _noise_in_steps(value, first, first + longest) >= limits.least_noise_steps


def _noise_in_steps(value: FloatArray, first: int, stop: int) -> float:
    """Return the noise of all but some rows in steps of its resolution, by its second differences; inf if too few."""
    steps = np.diff(np.concatenate((value[:first], value[stop:])))
    moved = np.abs(steps[steps != 0.0])
    if len(steps) < 3 or not len(moved):
        return math.inf
    return float(np.median(np.abs(np.diff(steps)))) * _STD_OF_SECOND_DIFFERENCE / float(moved.min())


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
        locked = signals.slip_rad_s[clutch_of_gear(event.from_gear) - 1]
        gaps.append(abs(float(locked[: grid_s.searchsorted(grid_s[0] + limits.locked_s)].mean())))
    if event.kind not in _WITHOUT_LOCK and event.end_reason is EndReason.COMPLETE:
        closed = signals.slip_rad_s[clutch_of_gear(event.to_gear) - 1][grid_s.searchsorted(end_s - limits.locked_s) :]
        middle = len(closed) // 2  # a coast change still slips; what a sensor reads too much changes less fast
        is_settling = abs(float(closed[middle:].mean() - closed[:middle].mean())) > limits.settling_rad_s
        gaps.append(0.0 if is_settling else abs(float(closed.mean())))
    return max(gaps, default=0.0)


def hub_gap_rad_s(signals: AlignedSignals, limits: QualityLimits = LIMITS) -> float:
    """Return the largest mean difference [rad/s] between engine and hub, which a torsion damper ties together."""
    start = signals.grid_s.searchsorted(0.0)  # before a launch the engine may be started
    apart_rad_s = signals.engine_speed.on_grid[start:] - signals.hub_speed.on_grid[start:]
    return _largest_mean(apart_rad_s, limits.speeds_mean_s)


def geared_stretches(
    event: Event, grid_s: FloatArray, clutch: SlippingClutch, limits: QualityLimits = LIMITS
) -> list[slice]:
    """Return the stretches of the grid in which each input shaft keeps its gear.

    Where the shafts say their gears, what is near a new one is left out: the shaft rings, and its message may be late.
    Where they do not, they stand in gear from a moment before the slip window on.
    """
    gears = [event.columns.get(signal) for signal in SHAFT_GEARS]
    first, second = gears
    if first is None or second is None:
        return [slice(max(0, clutch.rows.start - round(limits.in_gear_s / GRID_S)), len(grid_s))]
    held = np.stack([_held(series, event.start_ns, grid_s) for series in (first, second)])
    edges = np.flatnonzero((held[:, 1:] != held[:, :-1]).any(axis=0)) + 1
    ringing = round(limits.ringing_s / GRID_S)
    starts = [0, *(edges + ringing).tolist()]
    stretches = zip(starts, [*(edges - ringing).tolist(), len(grid_s)], strict=True)
    least = round(limits.speeds_mean_s / GRID_S)
    return [slice(start, stop) for start, stop in stretches if stop - start >= least and held[:, start].min() > 0.0]


def _held(series: Series, origin_ns: int, grid_s: FloatArray) -> FloatArray:
    """Return the value in force at each point of the grid; the first one before its time."""
    latest = ((series.t_ns - origin_ns) * NS_TO_S).searchsorted(grid_s, "right") - 1
    return series.value[np.maximum(latest, 0)]


def shaft_gap_rad_s(signals: AlignedSignals, rows: slice, limits: QualityLimits = LIMITS) -> float:
    """Return how far both input shafts are apart [rad/s], up to the ratio of their gears."""
    first, second = (speed.on_grid[rows] for speed in signals.input_speed)
    does_turn = second > limits.turning_rad_s  # at a standstill there is no ratio
    if not does_turn.any():
        return 0.0
    return _largest_mean(first - np.median(first[does_turn] / second[does_turn]) * second, limits.speeds_mean_s)


def _misses_command(signals: AlignedSignals, clutch: SlippingClutch, limits: QualityLimits) -> bool:
    """Return whether the slipping clutch's pressure is not the commanded one; False without a command.

    A piston on its way is held against nothing: its spring sets the pressure, whatever is commanded.
    """
    expected_pa = signals.expected_pa[clutch.number - 1]
    if expected_pa is None:
        return False
    first, touch_pa = clutch.rows.start, clutch.touch_pressure_pa
    read_pa = signals.pressure[clutch.number - 1].on_grid[clutch.rows] - clutch.pressure_zero_pa
    judged_pa = expected_pa[clutch.rows]
    longest = round(limits.catching_up_s / GRID_S)
    has_arrived = _arrived(read_pa, judged_pa, touch_pa + limits.travel_pa, limits.pressure_window_pa, longest)
    if np.count_nonzero(has_arrived) * GRID_S < limits.pressure_mean_s:
        return False
    by_clock_pa = limits.command_clock_s * abs(float(judged_pa[-1] - judged_pa[0])) / (len(judged_pa) * GRID_S)
    error_pa = np.maximum(read_pa, touch_pa) - np.maximum(judged_pa, touch_pa)
    rate_pa_s = np.gradient(expected_pa, GRID_S)[first : first + len(read_pa)]
    excused_pa = limits.following_ratio * COMMAND_LAG_S * np.abs(rate_pa_s)  # so far it may be ahead of the command
    beyond_pa = np.copysign(np.maximum(np.abs(error_pa) - excused_pa, 0.0), error_pa) * has_arrived
    return (
        abs(float(error_pa[has_arrived].mean())) > limits.pressure_window_pa + by_clock_pa
        or _largest_mean(beyond_pa, limits.pressure_mean_s) > limits.pressure_moment_pa
    )


def _arrived(
    read_pa: FloatArray, expected_pa: FloatArray, pressing_pa: float, behind_pa: float, longest: int
) -> BoolArray:
    """Return where a piston presses: not on its way, nor its pressure still rising to the command behind it.

    So long a rise lasts ``longest`` rows at most.
    """
    presses = read_pa > pressing_pa
    has_arrived, is_behind = presses.copy(), expected_pa - read_pa > behind_pa
    for start in (np.flatnonzero(presses[1:] & ~presses[:-1]) + 1).tolist():
        rising = is_behind[start : start + longest]
        has_arrived[start : start + (len(rising) if rising.all() else int(rising.argmin()))] = False
    return has_arrived


def _largest_mean(values: FloatArray, span_s: float) -> float:
    """Return the largest magnitude of the running mean over a span of the grid."""
    count, sums = min(round(span_s / GRID_S), len(values)), np.concatenate([[0.0], np.cumsum(values)])
    return float(np.abs(sums[count:] - sums[: len(sums) - count]).max()) / count


@dataclass(frozen=True, slots=True, kw_only=True)
class Meaning:
    """Whether signals that were asked for can be what the profile says, by the estimates of a drive so far."""

    doubt: str = ""  # what cannot be; empty as long as all of it can
    fit_count: int = 0  # of events
    misfit_count: int = 0

    def believes(self, estimate: ShiftEstimate) -> bool:
        """Return whether the estimate of an event that is counted here may be believed."""
        return not self.doubt or estimate.status is not Status.VALID

    def with_estimate(self, estimate: ShiftEstimate, calibration: Calibration) -> "Meaning":
        """Return the same after one more event; ``calibration`` is that of the type."""
        if self.doubt:
            return self
        if (friction := estimate.friction) is not None:
            new = calibration.clutches[estimate.clutch - 1].friction.mu_c
            ratio, spread = friction.mu_c / new, SURE_STD * friction.std_mu_c / new
            if ratio + spread < LEAST_RATIO or ratio - spread > MOST_RATIO:
                text = (
                    f"friction would be {ratio:.0%} of what this type has new: torque, pressure or their scales are "
                    "not what profile and calibration say"
                )
                return replace(self, doubt=text)
        fits = self.fit_count + (estimate.status is Status.VALID)  # also of a modelled torque
        misfits = self.misfit_count + (not _MISFITS.isdisjoint(estimate.reasons))
        is_off = misfits >= MOST_MISFITS and not fits
        text = f"none of {misfits} events fits: pressures, torque and speeds do not fit together as the profile says"
        return Meaning(doubt=text if is_off else "", fit_count=fits, misfit_count=misfits)
