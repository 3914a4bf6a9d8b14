"""Signals held against each other: what the torque balance alone would take for friction.

A sensor that lies changes the balance, and chi-square sees that, unless another friction would explain it as well: a
pressure that reads too low, a slip that reads too high. Each check here needs no friction. Limits are two to three
times what sound signals reach on drives with production scatter; docs/model.md, section "Estimator", has the figures.
"""

import math

import numpy as np

from canlog.arrays import FloatArray
from canlog.series import Series
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Signal
from diag_service.diagnosis.events import ShiftEvent
from diag_service.diagnosis.friction.belief import Belief
from diag_service.diagnosis.friction.parameters import State
from diag_service.diagnosis.friction.sampling import GRID_S, NS_TO_S
from diag_service.diagnosis.friction.signals import ShiftSignals
from diag_service.diagnosis.friction.window import SlipWindow
from diag_service.diagnosis.records import Reason

SPEED_LIMIT_RAD_S = 2.0  # between shafts that turn together; torsion of flywheel and shafts reaches 0.8
PRESSURE_LIMIT_PA = 0.20e5  # between a loaded clutch's pressure and its command, over `PRESSURE_MEAN_S`
WINDOW_PRESSURE_LIMIT_PA = 0.10e5  # the same over the whole slip window
MEAN_S = 0.05  # five samples: noise falls by half, a fault shorter than that weighs little
PRESSURE_MEAN_S = 0.06
LOCK_S = 0.10  # before the shift one clutch is locked, at its end the other one
SETTLED_S = 0.10  # before its slip window the on-coming shaft stands in gear
ZERO_GATE = 25.0  # squared distance of a measured zero from the known one, one degree of freedom: 6e-7 by chance
ROUNDING = 1e-6  # of a variance: far above what doubles lose, far below what a measurement tells
CHANCE = 1e-6  # that a sound signal repeats a value as often as one that is called frozen
CLIPPED_PA = 0.0  # a sensor that cannot show less than nothing repeats zero with reason


def doubts(
    event: ShiftEvent, signals: ShiftSignals, window: SlipWindow, clutch: int, belief: Belief
) -> tuple[Reason, ...]:
    """Return why the signals of a shift cannot all be true; empty if they can.

    Parameters
    ----------
    event, signals, window
        The shift, its signals on one clock, and its slip window.
    clutch : int
        The on-coming one, 1 or 2.
    belief
        The running state, which knows the zeros of the pressure sensors.
    """
    found = {
        Reason.SENSOR_FROZEN: any(is_frozen(event.columns[signal], signal) for signal in BALANCE_SIGNALS),
        Reason.SPEEDS_DISAGREE: speed_gap_rad_s(event, signals, window, clutch) > SPEED_LIMIT_RAD_S,
        Reason.PRESSURE_OFF_COMMAND: _misses_command(signals, window, clutch, belief),
    }
    return tuple(reason for reason, is_found in found.items() if is_found)


def zero_has_jumped(before: Belief, after: Belief) -> bool:
    """Return whether the zero of a pressure sensor, measured on an empty clutch, contradicts what was known of it.

    ``after`` is the running state with the measurement, ``before`` that without. A zero moves by its update, and the
    variance of the update is what the variance of the zero loses.
    """
    zeros = slice(State.ZERO1, State.ZERO2 + 1)
    moved_pa = after.mean[zeros] - before.mean[zeros]
    known = np.diag(before.covariance)[zeros]
    # A zero that was not measured moves a little with the other one; rounding must not make that a contradiction.
    variance = np.maximum(known - np.diag(after.covariance)[zeros], ROUNDING * known)
    return bool(np.any(moved_pa**2 > ZERO_GATE * variance))


def is_frozen(series: Series, signal: Signal) -> bool:
    """Return whether a signal repeats one value longer than its own noise and resolution explain.

    How often neighbours are equal elsewhere in the signal says how likely a repetition is.
    """
    value = series.value
    edges = np.flatnonzero(np.diff(value, prepend=np.nan, append=np.nan) != 0.0)
    lengths = np.diff(edges)
    longest = int(np.argmax(lengths))
    if "pressure" in signal and value[edges[longest]] <= CLIPPED_PA:
        return False
    others = len(value) - int(lengths[longest])
    repeats = others - (len(lengths) - 1)
    share = (repeats + 1.0) / (others + 2.0)
    return bool(lengths[longest] > 1.0 + math.log(CHANCE / len(value)) / math.log(share))


def speed_gap_rad_s(event: ShiftEvent, signals: ShiftSignals, window: SlipWindow, clutch: int) -> float:
    """Return the largest mean difference [rad/s] between speeds that must agree.

    Engine and hub at all times; hub and input shaft of the clutch that is locked before the shift and of the one that
    is locked at its end; both input shafts, whose gears are engaged, up to their ratio.
    """
    end_s = (event.end_ns - event.start_ns) * NS_TO_S
    grid_s = signals.grid_s
    before = signals.slip_rad_s(3 - clutch)[grid_s < grid_s[0] + LOCK_S]
    after = signals.slip_rad_s(clutch)[grid_s >= end_s - LOCK_S]
    geared = slice(max(0, window.first - round(SETTLED_S / GRID_S)), len(grid_s))
    first, second = (speed.on_grid[geared] for speed in signals.input_speed)
    apart = first - float(np.median(first / np.maximum(second, 1.0))) * second
    return max(
        _largest_mean(signals.engine_speed.on_grid - signals.hub_speed.on_grid, MEAN_S),
        _largest_mean(apart, MEAN_S),
        abs(float(np.mean(before))),
        abs(float(np.mean(after))),
    )


def _misses_command(signals: ShiftSignals, window: SlipWindow, clutch: int, belief: Belief) -> bool:
    """Tell whether the on-coming clutch's pressure is not the commanded one while it slips; False without command."""
    expected_pa = signals.expected_pa[clutch - 1]
    if expected_pa is None:
        return False
    inside = slice(window.first, window.stop)
    zero_pa = belief.mean[State.ZERO1 + clutch - 1]
    error_pa = (signals.pressure[clutch - 1].on_grid - zero_pa - expected_pa)[inside]
    return bool(
        abs(float(np.mean(error_pa))) > WINDOW_PRESSURE_LIMIT_PA
        or _largest_mean(error_pa, PRESSURE_MEAN_S) > PRESSURE_LIMIT_PA
    )


def _largest_mean(values: FloatArray, span_s: float) -> float:
    """Return the largest magnitude of the running mean over a span of the grid."""
    count = min(round(span_s / GRID_S), len(values))
    total = np.cumsum(np.insert(values, 0, 0.0))
    return float(np.max(np.abs(total[count:] - total[:-count])) / count)
