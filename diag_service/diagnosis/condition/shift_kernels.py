"""Compiled loops over the signals of a gear change: what `shift_quality` tells of it."""

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


@kernel
def stuck_rows(
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


@kernel
def largest_swing(slip_rad_s: FloatArray, pressed_rad_s: FloatArray) -> float:
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


@kernel
def fit_slopes(t_s: FloatArray, value: FloatArray, at_s: FloatArray, slopes: FloatArray) -> None:
    """Fit a parabola by least squares around each of some rising times; the slope of fewer than 3 samples stays.

    So does that of samples of fewer than 3 times: a log may tell them by the tenth of a second.
    """
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
            slopes[row] = slope / whole / SMOOTH_S if whole > LEAST_APART else slopes[row]


@kernel
def _mean(row: FloatArray, first: int, stop: int) -> float:
    total = 0.0
    for place in range(first, stop):
        total += row[place]
    return total / max(stop - first, 1)


def _slopes(car_m_s: FloatArray) -> FloatArray:
    """Return the slope of a straight line around each row [m/s2]; NaN near both ends."""
    slopes, along = np.full(len(car_m_s), np.nan), np.arange(-SLOPE_ROWS, SLOPE_ROWS + 1)
    if len(car_m_s) > 2 * SLOPE_ROWS:
        slopes[SLOPE_ROWS:-SLOPE_ROWS] = np.correlate(car_m_s, along, "valid") / (along @ along * GRID_S)
    return slopes


@kernel
def _speeds_told(
    rows: FloatArray,
    first: int,
    stop: int,
    is_handover: bool,  # noqa: FBT001
    skew_s: float,
) -> tuple[float, float, float]:
    """Return flare [rad/s], when slip ended [s], and how fast it did [rad/s2]."""
    engine, on, off = rows[ENGINE], rows[ON], rows[OFF]
    flare, peak, at, skew = np.nan, 0.0, -1, round(skew_s / GRID_S)
    for row in range(first, stop):
        slip = abs(engine[row] - on[row])
        if slip > peak:
            peak, at = slip, row
        if is_handover:
            least = np.inf
            for apart in range(-skew, skew + 1):
                beyond = 0.0
                for place in range(row - 1, row + 2):
                    low, high = min(on[place], off[place]), max(on[place], off[place])
                    one = engine[min(max(place + apart, 0), len(engine) - 1)]
                    beyond += max(one - high, low - one, 0.0) / 3.0
                least = min(least, beyond)
            flare = least if least < np.inf and not flare > least else flare
    if at < 0 or peak < SLIP_RAD_S:
        return flare, np.nan, np.nan
    row, sign = at, 1.0 if engine[at] > on[at] else -1.0
    while row < stop and sign * (engine[row] - on[row]) >= LOCKED_RAD_S:  # or beyond: rows may be far apart
        row += 1
    if row == stop:
        return flare, np.nan, np.nan
    moment, square, middle = 0.0, 0.0, 0.5 * (LANDING_ROWS - 1)
    for k in range(LANDING_ROWS):
        place = row - LANDING_ROWS + k
        moment += (k - middle) * abs(engine[place] - on[place])
        square += (k - middle) ** 2
    return flare, (row - first) * GRID_S, max(-moment / square / GRID_S, 0.0)


def _car_told(slopes: FloatArray, first: int, stop: int) -> tuple[float, float, float]:
    """Return by how much the car's acceleration fell below that before and after, its jerk, and the larger of both."""
    end = min(stop + 1, len(slopes) - SLOPE_ROWS)
    before = float(slopes[SLOPE_ROWS : first - SLOPE_ROWS // 2].mean())
    after = float(slopes[end - SLOPE_ROWS : end].mean())
    level = min(before, after)
    if math.isnan(level + after):
        return math.nan, math.nan, math.nan
    rises = np.abs(slopes[first:end] - slopes[first - JERK_ROWS : end - JERK_ROWS])
    hole, jerk = float(np.nanmax(level - slopes[first:end])), float(np.nanmax(rises)) / (JERK_ROWS * GRID_S)
    return max(hole, 0.0), jerk, max(abs(before), abs(after))


@kernel
def _loads_told(
    rows: FloatArray,
    first: int,
    stop: int,
    is_handover: bool,  # noqa: FBT001
    touch_pa: tuple[float, float],
    packs: tuple[tuple[float, float, float], tuple[float, float, float]],
    heat: tuple[float, float, float, float],
) -> tuple[float, float, float, float, float]:
    """Return what both clutches carried against each other [N m], the slip energy and the peak of each [J, K].

    ``heat`` is the oil, both packs and how long ago they were so warm [K, s]; a pack is warm throughout. ``packs``
    are of each the torque that it carries by pressure, what warms it and what cools it [N m/Pa, J/K, W/K].
    """
    tie_up, energy_on, energy_off = np.nan, 0.0, 0.0
    if math.isnan(rows[PRESSURE_ON, first]):
        return tie_up, np.nan, np.nan, np.nan, np.nan
    oil_k, age_s = heat[0], heat[3]
    (on_nm_pa, on_j_k, on_w_k), (off_nm_pa, off_j_k, off_w_k) = packs
    on_k = oil_k + (heat[1] - oil_k) * math.exp(-age_s * on_w_k / on_j_k)
    off_k = oil_k + (heat[2] - oil_k) * math.exp(-age_s * off_w_k / off_j_k)
    peak_on_k, peak_off_k = on_k, off_k
    for row in range(first, stop):
        on_pa = _mean(rows[PRESSURE_ON], row - 1, row + 2) - touch_pa[0]
        off_pa = _mean(rows[PRESSURE_OFF], row - 1, row + 2) - touch_pa[1]
        on_nm, off_nm = max(on_pa, 0.0) * on_nm_pa, max(off_pa, 0.0) * off_nm_pa
        on_slip = abs(rows[ENGINE, row] - rows[ON, row])
        power_w = on_nm * on_slip if on_slip > LOCKED_RAD_S else 0.0
        energy_on += power_w * GRID_S
        on_k += GRID_S * clutch_heating_rate_k_s(power_w, on_k, oil_k, on_j_k, on_w_k)
        peak_on_k = max(peak_on_k, on_k)
        if is_handover:
            off_slip = abs(rows[ENGINE, row] - rows[OFF, row])
            power_w = off_nm * off_slip if off_slip > LOCKED_RAD_S and off_pa > LOADED_PA else 0.0
            energy_off += power_w * GRID_S
            off_k += GRID_S * clutch_heating_rate_k_s(power_w, off_k, oil_k, off_j_k, off_w_k)
            peak_off_k = max(peak_off_k, off_k)
            both_nm = min(on_nm - abs(_mean(rows[TORQUE], row - 2, row + 3)), off_nm if off_pa > LOADED_PA else 0.0)
            if not math.isnan(both_nm) and not tie_up > both_nm:
                tie_up = max(both_nm, 0.0)
    return tie_up, energy_on, energy_off, peak_on_k, peak_off_k if is_handover else np.nan


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


@kernel
def _fill_told(
    rows: FloatArray, first: int, stop: int, touch_pa: float, stroke_pa: float
) -> tuple[float, float, float, float]:
    """Return how full the cavity is as torque is asked for, how long all takes, the pulse, what was too long [s]."""
    command, asked, pressure = rows[COMMAND], rows[ASKED], rows[PRESSURE_ON]
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
    at_end = 1.0 - max(touch_pa - _mean(pressure, last - FILLED_ROWS, last), 0.0) / stroke_pa
    short_pa = touch_pa - _mean(pressure, row - FILLED_ROWS, row)
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
    is_handover: bool,  # noqa: FBT001 - handed on to compiled functions
    skew_s: float,
    touch_pa: tuple[float, float],
    packs: tuple[tuple[float, float, float], tuple[float, float, float]],
    stroke_pa: float,
    heat: tuple[float, float, float, float],
) -> tuple[float, ...]:
    """Return the fields of `_Found`; the event lasts from row ``first`` to before ``stop``."""
    return (
        *_speeds_told(rows, first, stop, is_handover, skew_s),
        *_car_told(_slopes(rows[CAR]), first, stop),
        *_loads_told(rows, first, stop, is_handover, touch_pa, packs, heat),
        *_map_told(rows[COMMAND, :stop], rows[ASKED, :stop]),
        *_fill_told(rows, first, stop, touch_pa[0], stroke_pa),
        *response_told(rows, first, stop, touch_pa[0]),
    )


def compile_indices() -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    fit_slopes(np.zeros(1), np.zeros(1), np.zeros(1), np.zeros(1))
    stuck_rows(np.zeros(1), np.zeros(1), np.zeros(1, np.bool_), 0.0)
    largest_swing(np.zeros(1), np.zeros(1))
