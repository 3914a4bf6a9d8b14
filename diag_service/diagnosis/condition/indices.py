"""What speeds and torques alone say about a shift: its time, its slip, and the torque its clutch carried.

None of it is friction. Definitions and limits: docs/model.md, indices of a shift.
"""

import math
from typing import NamedTuple

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array
from canlog.jit import array_kernel
from clutch_model.calibration import Calibration, clutch_of_gear
from diag_service.diagnosis.alignment import readings
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import EndReason, Event
from diag_service.diagnosis.records import ShiftIndices
from diag_service.diagnosis.shifts.slip_tracking import LOADED_NM, LOADED_PA, SLIP_RAD_S

GRID_S = 0.005
NS_PER_S = 1e9
STUCK_RAD_S = 1.0  # below it slip has ended: the speeds of a clutch that sticks differ by their noise
STUCK_ROWS = 2  # of the grid, 0.01 s: for so long it does, before slip has ended
SWING_ROWS = 200  # of the grid, 1 s: a driveline swings at 8 Hz, for a while; what slips for longer was let slip
LET_GO_ROWS = 10  # of the grid, 0.05 s: a clutch without load for so long was let go
RELEASED_RATIO = 0.1  # an off-going clutch that is asked for less than this share has let go
MIN_TORQUE_NM = 10.0  # below it a ratio of torques says nothing
MIN_WINDOW_S = 0.1
SMOOTH_S = 0.06  # half width of the parabola that differentiates the engine speed
CORRELATION_S = 0.1  # residuals are alike for about as long as torque lags
INERTIA_STD_RATIO = 0.2  # of the engine inertia: below the first tier nobody has calibrated it for the vehicle


_SPEEDS = (Signal.HUB_SPEED, Signal.ENGINE_SPEED, Signal.INPUT1_SPEED, Signal.INPUT2_SPEED, Signal.INPUT_SPEED)
_PRESSURES = (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE)
_COMMANDS = (Signal.CLUTCH1_TORQUE_COMMAND, Signal.CLUTCH2_TORQUE_COMMAND)
_SIGNALS = (*_SPEEDS, Signal.CLUTCH_SLIP, *_PRESSURES, *_COMMANDS, Signal.CLUTCH_TORQUE, Signal.ENGINE_TORQUE)


class _Grid(NamedTuple):
    """The signals of a shift on one even grid from its start to its end."""

    t_s: FloatArray  # (n,) since the start of the shift
    values: dict[Signal, FloatArray]  # (n,) each, linear between samples; without those that are not there
    event: Event
    clutch: int  # that of the gear


def measure(event: Event, calibration: Calibration) -> ShiftIndices:
    """Return the indices of a shift as far as its signals go."""
    is_complete = event.end_reason is EndReason.COMPLETE and event.end_ns > event.start_ns
    shift_time_s = (event.end_ns - event.start_ns) / NS_PER_S
    t_s = np.arange(0.0, max(shift_time_s, GRID_S), GRID_S)
    values = readings(event.columns, _SIGNALS, event.start_ns, t_s)
    grid = _Grid(t_s, values, event, clutch_of_gear(event.to_gear))
    slip_rad_s = _slip(grid) if is_complete else None
    if slip_rad_s is None:
        return ShiftIndices(
            shift_time_s=shift_time_s if is_complete else None,
            slip_duration_s=None,
            peak_slip_rad_s=None,
            slip_angle_rad=None,
            torque_capacity_ratio=None,
            std_torque_capacity_ratio=None,
        )
    size = np.abs(slip_rad_s)
    ratio, std = _torque_capacity(grid, slip_rad_s, calibration) or (None, None)
    return ShiftIndices(
        shift_time_s=shift_time_s,
        slip_duration_s=float(np.count_nonzero(size > SLIP_RAD_S) * GRID_S),
        peak_slip_rad_s=float(size.max()),
        slip_angle_rad=float(size.sum() * GRID_S),
        torque_capacity_ratio=ratio,
        std_torque_capacity_ratio=std,
        reslip_rad_s=_reslip(size, _pressed(grid, calibration)),
    )


def _reslip(slip_rad_s: FloatArray, is_pressed: BoolArray) -> float:
    """Return the largest slip under load after it had begun and ended once [rad/s]: stick-slip, if there is much.

    Slip has begun when it is as large as three quarters of the largest: as a clutch bites, its shaft swings. It has
    ended when the clutch sticks, not as it passes zero. A clutch that was let go in between begins anew, and so does
    one that is let slip for long.
    """
    pressed_rad_s = np.where(is_pressed, slip_rad_s, 0.0)
    begun_rad_s = max(SLIP_RAD_S, 0.75 * float(pressed_rad_s.max()))
    first, stop = _stuck_rows(pressed_rad_s, slip_rad_s, is_pressed, begun_rad_s)
    return _largest_swing(slip_rad_s[first:stop], pressed_rad_s[first:stop]) if first < stop else 0.0


@array_kernel
def _stuck_rows(
    pressed_rad_s: FloatArray, slip_rad_s: FloatArray, is_pressed: BoolArray, begun_rad_s: float
) -> tuple[int, int]:
    """Return the rows from where a clutch that had begun to slip sticks until it is let go; none if it never does."""
    row, count = 0, len(slip_rad_s)
    while row < count and pressed_rad_s[row] <= begun_rad_s:
        row += 1
    stuck = 0
    while row < count and stuck < STUCK_ROWS:
        stuck = stuck + 1 if is_pressed[row] and slip_rad_s[row] < STUCK_RAD_S else 0
        row += 1
    if stuck < STUCK_ROWS:
        return count, count
    first, let_go = row - STUCK_ROWS, 0
    while row < count and let_go < LET_GO_ROWS:
        let_go = 0 if is_pressed[row] else let_go + 1
        row += 1
    return first, row - LET_GO_ROWS if let_go == LET_GO_ROWS else row


@array_kernel
def _largest_swing(slip_rad_s: FloatArray, pressed_rad_s: FloatArray) -> float:
    """Return the largest slip under load [rad/s] of stretches of slip that end as soon as a driveline swings back.

    Where there is no such stretch it is the least slip of all.
    """
    largest, least, peak, begin = -1.0, STUCK_RAD_S, 0.0, -1
    for row in range(len(slip_rad_s)):
        least = min(least, slip_rad_s[row])
        if slip_rad_s[row] >= STUCK_RAD_S:
            begin, peak = (row, 0.0) if begin < 0 else (begin, peak)
            peak = max(peak, pressed_rad_s[row])
        elif begin >= 0:
            largest = max(largest, peak) if row - begin <= SWING_ROWS else largest
            begin = -1
    return largest if largest >= 0.0 else least


def _pressed(grid: _Grid, calibration: Calibration) -> BoolArray:
    """Return where the clutch of the gear carries load, shape (n,); everywhere if nothing tells."""
    pressure_pa = grid.values.get(_PRESSURES[grid.clutch - 1])
    if pressure_pa is not None:
        return pressure_pa > calibration.clutches[grid.clutch - 1].touch_pressure_pa + LOADED_PA
    asked_nm = grid.values.get(_COMMANDS[grid.clutch - 1])
    return np.ones(len(grid.t_s), np.bool_) if asked_nm is None else asked_nm > LOADED_NM


def _slip(grid: _Grid) -> FloatArray | None:
    """Return the slip of the on-coming clutch: its input side less the shaft of the gear that engages."""
    hub = grid.values.get(Signal.HUB_SPEED)
    engine = hub if hub is not None else grid.values.get(Signal.ENGINE_SPEED)
    is_first = grid.clutch == 1
    shaft = grid.values.get(Signal.INPUT1_SPEED if is_first else Signal.INPUT2_SPEED)
    shaft = shaft if shaft is not None else grid.values.get(Signal.INPUT_SPEED)
    if engine is None:
        return None
    stated = None if shaft is not None else grid.values.get(Signal.CLUTCH_SLIP)
    return engine * stated if stated is not None else None if shaft is None else engine - shaft


def _torque_capacity(grid: _Grid, slip_rad_s: FloatArray, calibration: Calibration) -> tuple[float, float] | None:
    """Return the torque transmitted at slip over the one asked for, and its standard deviation; docs/model.md eq. (I4).

    Least squares through the origin; the deviation adds the scatter of the residuals, the gain and the offset of the
    engine torque, and the inertia.
    """
    asked = _asked(grid)
    engine_nm = grid.values.get(Signal.ENGINE_TORQUE)
    if asked is None or engine_nm is None or Signal.ENGINE_SPEED not in grid.event.columns:
        return None
    asked_nm, rows = np.empty(len(slip_rad_s)), np.empty(len(slip_rad_s), np.int64)
    count = _pick_asked(slip_rad_s, *asked, asked_nm, rows)
    if count * GRID_S < MIN_WINDOW_S:
        return None
    asked_nm, rows = asked_nm[:count], rows[:count]
    speed, accelerations = grid.event.columns[Signal.ENGINE_SPEED], np.zeros(count)
    _fit_slopes((speed.t_ns - grid.event.start_ns) / NS_PER_S, speed.value, grid.t_s[rows], accelerations)
    inertia_nm = calibration.input_side.engine_inertia_kg_m2 * accelerations
    by_engine, by_offset, by_inertia, scatter = _fit_ratio(asked_nm, engine_nm[rows], inertia_nm)
    spread = calibration.uncertainty
    parts = (
        scatter * math.sqrt(CORRELATION_S / GRID_S),
        spread.torque_gain_ratio * by_engine,
        spread.torque_offset_nm * by_offset,
        INERTIA_STD_RATIO * by_inertia,
    )
    return by_engine - by_inertia, math.hypot(*parts)


@array_kernel
def _fit_ratio(
    asked_nm: FloatArray, engine_nm: FloatArray, inertia_nm: FloatArray
) -> tuple[float, float, float, float]:
    """Return what engine, 1 N m and inertia are of the torque asked for, by least squares, and its scatter."""
    square, by_engine, by_offset, by_inertia, residual = 0.0, 0.0, 0.0, 0.0, 0.0
    for row in range(len(asked_nm)):
        square += asked_nm[row] ** 2
        by_offset += asked_nm[row]
        by_engine += asked_nm[row] * engine_nm[row]
        by_inertia += asked_nm[row] * inertia_nm[row]
    by_engine, by_offset, by_inertia = by_engine / square, by_offset / square, by_inertia / square
    for row in range(len(asked_nm)):
        residual += (engine_nm[row] - inertia_nm[row] - (by_engine - by_inertia) * asked_nm[row]) ** 2
    return by_engine, by_offset, by_inertia, math.sqrt(residual / len(asked_nm) / square)


def _asked(grid: _Grid) -> tuple[FloatArray, FloatArray, bool] | None:
    """Return the torques asked of the on-coming and of the off-going clutch, and whether their signs are the slip's."""
    on, off = grid.values.get(_COMMANDS[grid.clutch - 1]), grid.values.get(_COMMANDS[2 - grid.clutch])
    if on is not None and off is not None:
        return on, off, False
    total = grid.values.get(Signal.CLUTCH_TORQUE)
    return None if total is None else (total, np.zeros(len(total)), True)


@array_kernel
def _pick_asked(
    slip_rad_s: FloatArray,
    on_nm: FloatArray,
    off_nm: FloatArray,
    is_signed: bool,  # noqa: FBT001 - a compiled function
    asked_nm: FloatArray,
    rows: Int64Array,
) -> int:
    """Fill in the torque asked of a clutch that slips and alone carries the engine, signed as its slip, and where.

    Return how many rows there are.
    """
    count = 0
    for row in range(len(slip_rad_s)):
        if abs(slip_rad_s[row]) <= SLIP_RAD_S or abs(on_nm[row]) <= MIN_TORQUE_NM:
            continue
        if abs(off_nm[row]) < RELEASED_RATIO * max(on_nm[row], MIN_TORQUE_NM):
            asked_nm[count] = on_nm[row] if is_signed or slip_rad_s[row] > 0.0 else -on_nm[row]
            rows[count] = row
            count += 1
    return count


@array_kernel
def _fit_slopes(t_s: FloatArray, value: FloatArray, at_s: FloatArray, slopes: FloatArray) -> None:
    """Fit a parabola by least squares around each of some rising times; the slope of fewer than 3 samples stays."""
    first, last = 0, 0
    for row in range(len(at_s)):
        while first < len(t_s) and t_s[first] < at_s[row] - SMOOTH_S:
            first += 1
        while last < len(t_s) and t_s[last] < at_s[row] + SMOOTH_S:
            last += 1
        count, x1, x2, x3, x4, y, xy, xxy = last - first, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(first, last):
            x = (t_s[k] - at_s[row]) / SMOOTH_S
            x1, x2, x3, x4 = x1 + x, x2 + x * x, x3 + x * x * x, x4 + x * x * x * x
            y, xy, xxy = y + value[k], xy + x * value[k], xxy + x * x * value[k]
        if count >= 3:  # Cramer's rule
            whole = count * (x2 * x4 - x3 * x3) - x1 * (x1 * x4 - x2 * x3) + x2 * (x1 * x3 - x2 * x2)
            slope = count * (xy * x4 - x3 * xxy) - y * (x1 * x4 - x3 * x2) + x2 * (x1 * xxy - xy * x2)
            slopes[row] = slope / whole / SMOOTH_S


def compile_indices() -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    _fit_slopes(np.zeros(1), np.zeros(1), np.zeros(1), np.zeros(1))
    _fit_ratio(np.ones(1), np.ones(1), np.ones(1))
    _stuck_rows(np.zeros(1), np.zeros(1), np.zeros(1, np.bool_), 0.0)
    _largest_swing(np.zeros(1), np.zeros(1))
    _pick_asked(np.zeros(1), np.zeros(1), np.zeros(1), False, np.empty(1), np.empty(1, np.int64))
