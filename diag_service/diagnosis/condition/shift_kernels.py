"""Arithmetic on the signals of a gear change: what `shift_quality` tells of it."""

import math

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from canlog.jit import kernel
from clutch_model.pack import clutch_heating_rate_k_s
from diag_service.diagnosis.shifts.slip_tracking import LOADED_PA, SLIP_RAD_S

GRID_S = 0.01
SLOPE_ROWS = 8  # of the parabola that differentiates the car's speed: 0.08 s on either side
JERK_ROWS = 10  # 0.1 s, over which a change of acceleration is felt as one
LOCKED_RAD_S = 2.0  # below it slip has ended
LANDING_ROWS = 10  # 0.1 s before, whose slope of slip is that at which the clutch locks
ASKED_NM = 2.0  # above it a clutch is asked to carry
LEAST_PAIRS = 10  # of commanded torque and pressure, which tell the touch point that a control believes in
MAP_PA = 0.05e5  # rms: beyond it the command is no straight line of the torque
PULSE_PA = 1.0e5  # above the touch point, with no torque asked for: the clutch is being filled
FILLED_ROWS = 4  # before torque is asked for, whose mean pressure tells how full the cavity is
LEAST_FILLED = 0.1  # of the cavity, by a pulse: beyond it the flow is not known
STUCK_RAD_S = 1.0  # below it slip has ended: the speeds of a clutch that sticks differ by their noise
STUCK_ROWS = 2  # of the grid, 0.01 s: for so long it does, before slip has ended
SWING_ROWS = 200  # of the grid, 1 s: a driveline swings at 8 Hz, for a while; what slips for longer was let slip
LET_GO_ROWS = 10  # of the grid, 0.05 s: a clutch without load for so long was let go
RELEASED_RATIO = 0.1  # an off-going clutch that is asked for less than this share has let go
MIN_TORQUE_NM = 10.0  # below it a ratio of torques says nothing
SMOOTH_S = 0.06  # half width of the parabola that differentiates the engine speed
LEAST_APART = 1e-6  # a determinant: three samples a few milliseconds apart have as much
ENGINE, ON, OFF, CAR, PRESSURE_ON, PRESSURE_OFF, COMMAND, ASKED, TORQUE, ROW_COUNT = range(10)  # of rows


def stuck_rows(
    pressed_rad_s: FloatArray, slip_rad_s: FloatArray, is_pressed: BoolArray, begun_rad_s: float
) -> tuple[int, int]:
    """Return the rows from where a clutch that had begun to slip sticks until it is let go; none if it never does."""
    count = len(slip_rad_s)
    has_begun = ~(pressed_rad_s <= begun_rad_s)
    is_stuck, pressed = (is_pressed & (slip_rad_s < STUCK_RAD_S)).tolist(), is_pressed.tolist()
    row, stuck = int(has_begun.argmax()) if has_begun.any() else count, 0
    while row < count and stuck < STUCK_ROWS:
        stuck = stuck + 1 if is_stuck[row] else 0
        row += 1
    if stuck < STUCK_ROWS:
        return count, count
    first, let_go = row - STUCK_ROWS, 0
    while row < count and let_go < LET_GO_ROWS:
        let_go = 0 if pressed[row] else let_go + 1
        row += 1
    return first, row - LET_GO_ROWS if let_go == LET_GO_ROWS else row


def largest_swing(slip_rad_s: FloatArray, pressed_rad_s: FloatArray) -> float:
    """Return the largest slip under load [rad/s] of stretches of slip that end as soon as a driveline swings back.

    Where there is no such stretch it is the least slip of all.
    """
    largest, least, peak, begin = -1.0, STUCK_RAD_S, 0.0, -1
    for row, (slip, pressed) in enumerate(zip(slip_rad_s.tolist(), pressed_rad_s.tolist(), strict=True)):
        least = min(least, slip)
        if slip >= STUCK_RAD_S:
            begin, peak = (row, 0.0) if begin < 0 else (begin, peak)
            peak = max(peak, pressed)
        elif begin >= 0:
            largest = max(largest, peak) if row - begin <= SWING_ROWS else largest
            begin = -1
    return largest if largest >= 0.0 else least


def fit_ratio(asked_nm: FloatArray, engine_nm: FloatArray, inertia_nm: FloatArray) -> tuple[float, float, float, float]:
    """Return what engine, 1 N m and inertia are of the torque asked for, by least squares, and its scatter."""
    square = float(asked_nm @ asked_nm)
    by_engine, by_offset, by_inertia = (
        float(asked_nm @ one) / square for one in (engine_nm, np.ones_like(asked_nm), inertia_nm)
    )
    residual = engine_nm - inertia_nm - (by_engine - by_inertia) * asked_nm
    return by_engine, by_offset, by_inertia, math.sqrt(float(np.mean(residual**2)) / square)


def asked_alone(slip_rad_s: FloatArray, on_nm: FloatArray, off_nm: FloatArray) -> BoolArray:
    """Return where a clutch slips and alone is asked to carry the engine."""
    is_released = np.abs(off_nm) < RELEASED_RATIO * np.maximum(on_nm, MIN_TORQUE_NM)
    return (np.abs(slip_rad_s) > SLIP_RAD_S) & (np.abs(on_nm) > MIN_TORQUE_NM) & is_released


def fit_slopes(t_s: FloatArray, value: FloatArray, at_s: FloatArray, slopes: FloatArray) -> None:
    """Fit a parabola by least squares around each of some rising times; the slope of fewer than 3 samples stays.

    So does that of samples of fewer than 3 times: a log may tell them by the tenth of a second.
    """
    first, stop = t_s.searchsorted(at_s - SMOOTH_S), t_s.searchsorted(at_s + SMOOTH_S)
    count = stop - first
    places = first[:, np.newaxis] + np.arange(count.max(initial=1))
    is_near = places < stop[:, np.newaxis]
    places = np.minimum(places, len(t_s) - 1)
    x = (t_s[places] - at_s[:, np.newaxis]) / SMOOTH_S * is_near
    y = value[places] * is_near
    x1, x2, x3, x4 = (np.sum(x**power, axis=1) for power in range(1, 5))
    y0, xy, xxy = (np.sum(x**power * y, axis=1) for power in range(3))
    whole = count * (x2 * x4 - x3 * x3) - x1 * (x1 * x4 - x2 * x3) + x2 * (x1 * x3 - x2 * x2)  # Cramer's rule
    slope = count * (xy * x4 - x3 * xxy) - y0 * (x1 * x4 - x3 * x2) + x2 * (x1 * xxy - xy * x2)
    rows = np.flatnonzero((count >= 3) & (whole > LEAST_APART))
    slopes[rows] = slope[rows] / whole[rows] / SMOOTH_S


def _mean_around(values: FloatArray, first: int, stop: int, reach: int) -> FloatArray:
    """Return the mean of each row and those within ``reach`` of it."""
    shifts = range(-reach, reach + 1)
    return np.asarray(sum(values[first + shift : stop + shift] for shift in shifts) / len(shifts))


def _slopes(car_m_s: FloatArray) -> FloatArray:
    """Return the slope of a straight line around each row [m/s2]; NaN near both ends."""
    slopes, along = np.full(len(car_m_s), np.nan), np.arange(-SLOPE_ROWS, SLOPE_ROWS + 1)
    if len(car_m_s) > 2 * SLOPE_ROWS:
        slopes[SLOPE_ROWS:-SLOPE_ROWS] = np.correlate(car_m_s, along, "valid") / (along @ along * GRID_S)
    return slopes


def _speeds_told(
    rows: FloatArray, first: int, stop: int, skew_s: float, *, is_handover: bool
) -> tuple[float, float, float]:
    """Return flare [rad/s], when slip ended [s], and how fast it did [rad/s2]."""
    engine, on, off = rows[ENGINE], rows[ON], rows[OFF]
    flare, skew = np.nan, round(skew_s / GRID_S)
    if is_handover:
        around = np.arange(first - 1, stop + 1)
        low, high = np.minimum(on[around], off[around]), np.maximum(on[around], off[around])
        engines = engine[np.clip(around + np.arange(-skew, skew + 1)[:, np.newaxis], 0, len(engine) - 1)]
        beyond = np.maximum(np.maximum(engines - high, low - engines), 0.0) / 3.0
        least = np.fmin.reduce(beyond[:, :-2] + beyond[:, 1:-1] + beyond[:, 2:])
        flare = float(np.fmax.reduce(least, initial=np.nan))
    if first == stop:
        return flare, np.nan, np.nan
    turning = engine - on
    slip = np.nan_to_num(np.abs(turning[first:stop]))
    at = first + int(slip.argmax())
    if slip[at - first] < SLIP_RAD_S:
        return flare, np.nan, np.nan
    sign = 1.0 if turning[at] > 0.0 else -1.0
    ended = np.flatnonzero(~(sign * turning[at:stop] >= LOCKED_RAD_S))  # or beyond: rows may be far apart
    if not len(ended):
        return flare, np.nan, np.nan
    row = at + int(ended[0])
    along = np.arange(LANDING_ROWS) - 0.5 * (LANDING_ROWS - 1)
    slope = float(along @ np.abs(turning[row - LANDING_ROWS : row])) / float(along @ along) / GRID_S
    return flare, (row - first) * GRID_S, max(-slope, 0.0)


def _car_told(slopes: FloatArray, first: int, stop: int) -> tuple[float, float, float]:
    """Return by how much the car's acceleration fell below that before and after, its jerk, and the larger of both."""
    end = min(stop + 1, len(slopes) - SLOPE_ROWS)
    if end <= first:
        return math.nan, math.nan, math.nan
    before = float(slopes[SLOPE_ROWS : first - SLOPE_ROWS // 2].mean())
    after = float(slopes[end - SLOPE_ROWS : end].mean())
    level = min(before, after)
    if math.isnan(level + after):
        return math.nan, math.nan, math.nan
    rises = np.abs(slopes[first:end] - slopes[first - JERK_ROWS : end - JERK_ROWS])
    hole, rise = float(np.fmax.reduce(level - slopes[first:end])), float(np.fmax.reduce(rises))
    return max(hole, 0.0), rise / (JERK_ROWS * GRID_S), max(abs(before), abs(after))


def _loads_told(
    rows: FloatArray,
    first: int,
    stop: int,
    touch_pa: tuple[float, float],
    packs: tuple[tuple[float, float, float], tuple[float, float, float]],
    heat: tuple[float, float, float, float],
    *,
    is_handover: bool,
) -> tuple[float, float, float, float, float]:
    """Return what both clutches carried against each other [N m], the slip energy and the peak of each [J, K].

    ``heat`` is the oil, both packs and how long ago they were so warm [K, s]; a pack is warm throughout. ``packs``
    are of each the torque that it carries by pressure, what warms it and what cools it [N m/Pa, J/K, W/K].
    """
    if first == stop or math.isnan(rows[PRESSURE_ON, first]):
        return np.nan, np.nan, np.nan, np.nan, np.nan
    on_pa, off_pa = (
        _mean_around(rows[row], first, stop, 1) - touch
        for row, touch in zip((PRESSURE_ON, PRESSURE_OFF), touch_pa, strict=True)
    )
    on_nm, off_nm = (np.maximum(pa, 0.0) * pack[0] for pa, pack in zip((on_pa, off_pa), packs, strict=True))
    on_slip, off_slip = (np.abs(rows[ENGINE, first:stop] - rows[shaft, first:stop]) for shaft in (ON, OFF))
    on_w = np.where(on_slip > LOCKED_RAD_S, on_nm * on_slip, 0.0)
    energy_on, peak_on_k = _heated(on_w, heat[1], heat, packs[0])
    if not is_handover:
        return np.nan, energy_on, 0.0, peak_on_k, np.nan
    off_w = np.where((off_slip > LOCKED_RAD_S) & (off_pa > LOADED_PA), off_nm * off_slip, 0.0)
    energy_off, peak_off_k = _heated(off_w, heat[2], heat, packs[1])
    spare_nm = on_nm - np.abs(_mean_around(rows[TORQUE], first, stop, 2))
    both_nm = np.minimum(spare_nm, np.where(off_pa > LOADED_PA, off_nm, 0.0))
    tie_up = max(float(np.fmax.reduce(both_nm)), 0.0)
    return tie_up, energy_on, energy_off, peak_on_k, peak_off_k


def _heated(
    power_w: FloatArray, pack_k: float, heat: tuple[float, float, float, float], pack: tuple[float, float, float]
) -> tuple[float, float]:
    """Return the slip energy of a pack [J] and its highest temperature [K]."""
    (oil_k, _, _, age_s), (_, heat_j_k, cooling_w_k) = heat, pack
    start_k = oil_k + (pack_k - oil_k) * math.exp(-age_s * cooling_w_k / heat_j_k)
    return float(power_w.sum()) * GRID_S, _peak_k(power_w, start_k, oil_k, heat_j_k, cooling_w_k)


@kernel
def _peak_k(power_w: FloatArray, start_k: float, oil_k: float, heat_j_k: float, cooling_w_k: float) -> float:
    """Return the highest temperature of a pack [K] that a power heats from row to row."""
    k = peak_k = start_k
    for row in range(power_w.size):
        k += GRID_S * clutch_heating_rate_k_s(power_w[row], k, oil_k, heat_j_k, cooling_w_k)
        peak_k = max(peak_k, k)
    return peak_k


def _map_told(command_pa: FloatArray, asked_nm: FloatArray) -> tuple[float, float]:
    """Return the pressure at which the control believes that the clutch carries nothing [Pa], and its deviation."""
    before, here, after = asked_nm[:-2], asked_nm[1:-1], asked_nm[2:]
    is_steady = np.abs(after - before) < 15.0  # commands of two messages, a row apart
    is_told = is_steady & (np.minimum(np.minimum(before, after), here) > ASKED_NM)
    x, y = here[is_told], command_pa[1:-1][is_told]
    across = float(x.var()) if len(x) >= LEAST_PAIRS else 0.0
    if not across > 100.0:  # 10 N m
        return math.nan, math.nan
    slope = float((x - x.mean()) @ y) / len(x) / across
    rms = math.sqrt(max(float(y.var()) - slope * slope * across, 0.0))
    if rms > MAP_PA:
        return math.nan, math.nan
    std = rms * math.sqrt((1.0 + float(x.mean()) ** 2 / across) / len(x))
    return float(y.mean()) - slope * float(x.mean()), std + 500.0  # half a step of the command


def _fill_told(
    rows: FloatArray, first: int, stop: int, touch_pa: float, stroke_pa: float
) -> tuple[float, float, float, float]:
    """Return how full the cavity is as torque is asked for, how long all takes, the pulse, what was too long [s]."""
    command, asked, pressure = (rows[row].tolist() for row in (COMMAND, ASKED, PRESSURE_ON))
    row, pulse, ended, full = first, 0, first, -1
    while row < stop and not (asked[row] >= ASKED_NM and pulse > 0):
        if asked[row] < ASKED_NM and command[row] > touch_pa + PULSE_PA:
            pulse, ended = pulse + 1, row + 1
        if full < 0 and pressure[row] > touch_pa + LOADED_PA and pressure[row + 1] > touch_pa + LOADED_PA:
            full = row if pulse > 0 else -1
        row += 1
    if row >= stop or pulse == 0 or stroke_pa <= 0.0:  # such a spring does not tell how far its piston has gone
        return np.nan, np.nan, np.nan, np.nan
    if full >= 0:
        return 1.0, pulse * GRID_S, pulse * GRID_S, max((ended - full) * GRID_S, 0.0)
    last = min(ended + 1 + FILLED_ROWS, row)  # a valve goes on for a moment
    at_end = 1.0 - max(touch_pa - sum(pressure[last - FILLED_ROWS : last]) / FILLED_ROWS, 0.0) / stroke_pa
    short_pa = touch_pa - sum(pressure[row - FILLED_ROWS : row]) / FILLED_ROWS
    return 1.0 - max(short_pa, 0.0) / stroke_pa, pulse * GRID_S / max(at_end, LEAST_FILLED), pulse * GRID_S, 0.0


def response_told(rows: FloatArray, first: int, stop: int, touch_pa: float) -> tuple[float, float, float]:
    """Return how the pressure of a closed clutch follows its command: lag [s], ratio, and what the highest lacks [Pa].

    By least squares: the pressure is a part of the command and of its slope.
    """
    command, pressure = rows[COMMAND] - touch_pa, rows[PRESSURE_ON] - touch_pa
    at = np.arange(first + 2, min(stop + 8, len(command) - 2))
    is_closed = (pressure[at - 2] > LOADED_PA) & (pressure[at] > LOADED_PA)
    at = at[is_closed & (np.minimum(command[at - 2], command[at + 2]) > PULSE_PA)]
    if len(at) < LEAST_PAIRS:
        return math.nan, math.nan, math.nan
    by = np.stack([command[at], (command[at + 1] - command[at - 1]) / (2.0 * GRID_S)])
    by -= by.mean(axis=1, keepdims=True)
    (cc, cd), (_, dd) = (by @ by.T).tolist()
    pc, pd = (by @ pressure[at]).tolist()
    whole = cc * dd - cd * cd
    if not whole > 0.0:
        return math.nan, math.nan, math.nan
    reach, by_slope = (pc * dd - pd * cd) / whole, (pd * cc - pc * cd) / whole
    top = int(at[command[at].argmax()])
    stays = min(top + 4, len(pressure) - 3)
    return -by_slope / reach, reach, float(command[top] - pressure[stays - 2 : stays + 3].mean())


def quality_told(
    rows: FloatArray,
    first: int,
    stop: int,
    skew_s: float,
    touch_pa: tuple[float, float],
    packs: tuple[tuple[float, float, float], tuple[float, float, float]],
    stroke_pa: float,
    heat: tuple[float, float, float, float],
    *,
    is_handover: bool,
) -> tuple[float, ...]:
    """Return the fields of `_Found`; the event lasts from row ``first`` to before ``stop``."""
    return (
        *_speeds_told(rows, first, stop, skew_s, is_handover=is_handover),
        *_car_told(_slopes(rows[CAR]), first, stop),
        *_loads_told(rows, first, stop, touch_pa, packs, heat, is_handover=is_handover),
        *_map_told(rows[COMMAND, :stop], rows[ASKED, :stop]),
        *_fill_told(rows, first, stop, touch_pa[0], stroke_pa),
        *response_told(rows, first, stop, touch_pa[0]),
    )
