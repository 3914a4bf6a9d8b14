"""What a gear change was like by speeds and torques alone: indices, each with its standard deviation.

Definitions and limits: docs/model.md, indices of a shift. What signals tell and how well is in ``index_signals``.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from clutch_model.calibration import Calibration, clutch_of_gear
from clutch_model.units import NS_PER_S
from clutch_results.event_kinds import EndReason, NotMeasured, ShiftIndices
from clutchdiag_io.people import STDS
from diag_service.diagnosis.alignment import COMMAND_LAG_S, readings
from diag_service.diagnosis.columns import GearRatios, Signal
from diag_service.diagnosis.condition.index_signals import (
    AGE_STD_S,
    GEARS,
    UNIFORM,
    WHEELS,
    IndexValue,
    Ratios,
    SignalCourse,
    Slip,
    car_speed,
    engine_samples,
    gear_ratios,
    is_one_shaft,
    jerk_of,
    judder_of,
    largest,
    shaft_samples,
    slip_on,
    slopes_at,
    stated_ratios,
)
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.shifts.shifts import LOADED_NM, LOADED_PA, PRESSURES, SLIP_RAD_S

INDEX_GRID_S = 0.005  # of the indices
SLOPES_EVERY = 2  # rows of the grid: 0.01 s, a sixth of what they are smoothed by
MIN_WINDOW_S = 0.1  # of slip under the engine's torque alone: less tells no capacity
CORRELATION_S = 0.1  # residuals are alike for about as long as torque lags
INERTIA_STD_RATIO = 0.1  # of engine and hub: below the first tier nobody has calibrated it for the vehicle
STUCK_RAD_S = 1.0  # below it slip has ended: the speeds of a clutch that sticks differ by their noise
STUCK_ROWS = 2  # of the grid, 0.01 s: for so long it does, before slip has ended
SWING_ROWS = 200  # of the grid, 1 s: a driveline swings at 8 Hz, for a while; what slips for longer was let slip
LET_GO_ROWS = 10  # of the grid, 0.05 s: a clutch without load for so long was let go
RELEASED_RATIO = 0.1  # an off-going clutch that is asked for less than this share has let go
MIN_TORQUE_NM = 10.0  # below it a ratio of torques says nothing
ALONG: Final = np.arange(-3.0, 4.0)  # rows of the grid, 0.03 s: over which slip passes its threshold
PEAK_S: Final = 0.05  # over which the largest slip is a mean: a shaft springs for 0.02 s as its backlash closes
CREST_RATIO: Final = math.sqrt(120.0) / 12.0  # of their rms distance: by which chords stay below a crest, in the mean
LEAST_SLOPE_RAD_S2: Final = 1.0  # of slip as it passes the threshold: what is slower never passes it
MOST = 1e12  # of any index, whatever its unit: a damaged value of a log may be any number

_COMMANDS: Final = (Signal.CLUTCH1_TORQUE_COMMAND, Signal.CLUTCH2_TORQUE_COMMAND)
_GRID_SIGNALS: Final = (Signal.ENGINE_SPEED, Signal.CLUTCH_SLIP, *PRESSURES, *_COMMANDS, Signal.CLUTCH_TORQUE)


class _Grid(NamedTuple):
    """The signals of a shift on one even grid from its start to its end."""

    t_s: FloatArray  # (n,) since the start of the shift
    values: dict[Signal, FloatArray]  # (n,) each, linear between samples; without those that are not there
    event: Event
    clutch: int  # that of the gear
    engine_nm: FloatArray | None  # torque of the engine, of its latency ago


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # a damaged value of a log may be any number
def measure(event: Event, calibration: Calibration, gears: GearRatios | None = None) -> ShiftIndices:
    """Return the indices of a shift as far as its signals go; ``gears`` are what a description tells of the car's."""
    if event.end_reason is not EndReason.COMPLETE or event.end_ns <= event.start_ns:
        return ShiftIndices(not_measured={"shift_time_s": NotMeasured.NOT_COMPLETED})
    duration_s = (event.end_ns - event.start_ns) / NS_PER_S
    engine = engine_samples(event, calibration)
    gaps_s = _edge_gap_s(event, event.start_ns, engine), _edge_gap_s(event, event.end_ns, engine)
    found = _Found({"shift_time_s": duration_s, "std_shift_time_s": _between_std_s(*gaps_s)}, {})
    ratios = Ratios() if engine is None else gear_ratios(event, engine, duration_s, gaps_s)
    for name, ratio in (("ratio_before", ratios.before), ("ratio_after", ratios.after)):
        is_told = ratios.over is Signal.OUTPUT_SPEED  # over the car's speed it would not be a number
        found.put(name, (ratio or NotMeasured.NOT_LOCKED) if is_told else NotMeasured.SIGNAL_MISSING)
    t_s = np.arange(0.0, max(duration_s, 2.0 * INDEX_GRID_S), INDEX_GRID_S)  # a slope needs two rows
    grid = _grid_of(event, t_s, calibration)
    on = off = None
    if engine is not None:
        stated = stated_ratios(event, gears)
        on = _shaft(event, event.to_gear, ratios.after, stated.after, (ratios.over, stated.over))
        off = _shaft(event, event.from_gear, ratios.before, stated.before, (ratios.over, stated.over))
    if engine is None or on is None:
        slip = _stated_slip(grid)
    else:
        slopes_s = t_s[::SLOPES_EVERY]
        slip = slip_on(t_s, engine, np.interp(t_s, slopes_s, slopes_at(engine, slopes_s)), *on)
    if slip is None:
        why = NotMeasured.SIGNAL_MISSING if ratios.over is None or engine is None else NotMeasured.NOT_LOCKED
        if is_one_shaft(event):
            why = NotMeasured.SHAFT_UNKNOWN
        found.missing(
            why, "slip_duration_s", "peak_slip_rad_s", "judder_rad_s", "slip_energy_j", "torque_capacity_ratio"
        )
    else:
        off_rad_s = None
        if engine is not None and off is not None and event.from_gear != event.to_gear:
            off_rad_s = engine.at(t_s) - off[0].at(t_s)
        _slip_indices(found, grid, slip, off_rad_s, gaps_s, calibration)
    found.put("jerk_m_s3", _jerk(event, duration_s))
    return ShiftIndices(**found.numbers, not_measured=found.reasons)


def _shaft(
    event: Event,
    gear: int,
    ratio: IndexValue | None,
    stated: IndexValue | None,
    over: tuple[Signal | None, Signal | None],
) -> tuple[SignalCourse, float] | None:
    """Return the speed of a gear's shaft; where its ratio was not seen, by the stated one."""
    return shaft_samples(event, gear, ratio or stated, over[1] if ratio is None else over[0])


def _jerk(event: Event, duration_s: float) -> IndexValue | NotMeasured:
    """Return the jerk of the car, if its speed is told finely enough."""
    car = car_speed(event.columns, event.start_ns)
    if car is None:
        is_there = any(signal in event.columns for signal in (Signal.VEHICLE_SPEED, *WHEELS))
        return NotMeasured.TOO_COARSE if is_there else NotMeasured.SIGNAL_MISSING
    return jerk_of(car, 0.0, duration_s) if car.is_fine else NotMeasured.TOO_COARSE


class _Found(NamedTuple):
    """Indices by their names, and why others are not to be had."""

    numbers: dict[str, float]
    reasons: dict[str, NotMeasured]

    def put(self, name: str, found: IndexValue | NotMeasured) -> None:
        """Note an index and its deviation, or why there is none."""
        if isinstance(found, NotMeasured):
            self.reasons[name] = found
        elif abs(found.value) + found.std < MOST:  # nor is what is not a number
            self.numbers.update({name: found.value, f"std_{name}": found.std})
        else:
            self.reasons[name] = NotMeasured.UNTRUSTED

    def missing(self, why: NotMeasured, *names: str) -> None:
        self.reasons.update(dict.fromkeys(names, why))


def _grid_of(event: Event, t_s: FloatArray, calibration: Calibration) -> _Grid:
    values = readings(event.columns, _GRID_SIGNALS, event.start_ns, t_s)
    later_s = t_s + calibration.bias.torque_latency_s
    engine_nm = readings(event.columns, [Signal.ENGINE_TORQUE], event.start_ns, later_s).get(Signal.ENGINE_TORQUE)
    return _Grid(t_s, values, event, clutch_of_gear(event.to_gear), engine_nm)


def _edge_gap_s(event: Event, t_ns: int, engine: SignalCourse | None) -> float:
    """Return between which samples the beginning or end of an event lies [s]: those of gears, if these tell it."""
    for signal in GEARS:
        series = event.columns.get(signal)
        if series is None:
            continue
        row = int(series.t_ns.searchsorted(t_ns))
        if 0 < row < len(series.t_ns) and series.t_ns[row] == t_ns and series.value[row] != series.value[row - 1]:
            return float(series.t_ns[row] - series.t_ns[row - 1]) / NS_PER_S
    return 0.0 if engine is None else engine.gap_at_s((t_ns - event.start_ns) / NS_PER_S)


def _between_std_s(begin_gap_s: float, end_gap_s: float) -> float:
    """Return the deviation of a time between moments, each of which lies in a gap before the sample that tells it."""
    return math.hypot(UNIFORM * begin_gap_s, UNIFORM * end_gap_s, 0.5 * (end_gap_s - begin_gap_s))


def _stated_slip(grid: _Grid) -> Slip | None:
    """Return the slip that the transmission controller states."""
    stated = SignalCourse.of(grid.event.columns.get(Signal.CLUTCH_SLIP), grid.event.start_ns)
    engine = SignalCourse.of(grid.event.columns.get(Signal.ENGINE_SPEED), grid.event.start_ns)
    if stated is None or engine is None:
        return None
    turning = engine.at(grid.t_s)
    std = np.hypot(stated.std * turning, engine.std)
    return Slip(
        turning * stated.at(grid.t_s),
        std,
        float(np.median(std)),
        np.zeros_like(std),
        slopes_at(engine, grid.t_s),
        max(engine.gap_s, stated.gap_s),
    )


def _slip_indices(
    found: _Found,
    grid: _Grid,
    slip: Slip,
    off_rad_s: FloatArray | None,
    gaps_s: tuple[float, float],
    calibration: Calibration,
) -> None:
    """Note what the slip of the on-coming clutch tells; ``off_rad_s`` is that of the off-going one, if it is known."""
    size = np.abs(slip.rad_s)
    plain = {
        "slip_angle_rad": float(size.sum()) * INDEX_GRID_S,
        "reslip_rad_s": _reslip(size, _pressed(grid, calibration)),
    }
    found.numbers.update({name: value for name, value in plain.items() if value < MOST})
    found.put("slip_duration_s", _slip_time(size, slip.std_rad_s, gaps_s))
    found.put("peak_slip_rad_s", _peak(size, slip, gaps_s))
    found.put("judder_rad_s", judder_of(slip, size > SLIP_RAD_S, INDEX_GRID_S))
    capacity = _torque_capacity(grid, slip, off_rad_s, calibration)
    found.put("torque_capacity_ratio", capacity)
    found.put("slip_energy_j", _heat(grid, slip, off_rad_s, capacity, calibration))


def _slip_time(size_rad_s: FloatArray, std_rad_s: FloatArray, gaps_s: tuple[float, float]) -> IndexValue:
    """Return for how long slip is beyond its threshold [s]; what is on as the event begins began half a gap before."""
    beyond = size_rad_s - SLIP_RAD_S
    low, high = np.minimum(beyond[:-1], beyond[1:]), np.maximum(beyond[:-1], beyond[1:])
    share = np.clip(high / np.maximum(high - low, 1e-12), 0.0, 1.0)  # of each step, linear
    time_s = float(np.where(low >= 0.0, 1.0, np.where(high <= 0.0, 0.0, share)).sum()) * INDEX_GRID_S
    passed = np.flatnonzero((beyond[:-1] > 0.0) != (beyond[1:] > 0.0))
    slopes = np.abs(np.correlate(np.pad(size_rad_s, 3, mode="edge"), ALONG, "valid")) / (ALONG @ ALONG * INDEX_GRID_S)
    spread_s = np.minimum(std_rad_s[passed] / np.maximum(slopes[passed], LEAST_SLOPE_RAD_S2), time_s + INDEX_GRID_S)
    variance = float(np.sum(spread_s**2)) + len(passed) * AGE_STD_S**2
    if beyond[0] > 0.0:
        time_s += 0.5 * gaps_s[0]
        variance += (UNIFORM * gaps_s[0]) ** 2
    if beyond[-1] > 0.0:
        time_s += INDEX_GRID_S - 0.5 * gaps_s[1]
        variance += (UNIFORM * gaps_s[1]) ** 2
    return IndexValue(max(time_s, 0.0), math.sqrt(variance + (UNIFORM * INDEX_GRID_S) ** 2))


def _peak(size_rad_s: FloatArray, slip: Slip, gaps_s: tuple[float, float]) -> IndexValue:
    """Return the largest slip, mean over 0.05 s [rad/s], freed of what the choice among like ones adds."""
    reach = round(0.5 * PEAK_S / INDEX_GRID_S)
    width = 2 * reach + 1
    padded = np.pad(size_rad_s, reach, mode="reflect", reflect_type="odd") if len(size_rad_s) > reach else size_rad_s
    means = np.convolve(padded, np.full(width, 1.0 / width), "valid") if len(padded) >= width else size_rad_s
    at = int(means.argmax())
    around = max(reach, round(slip.gap_s / INDEX_GRID_S))  # a sample on either side
    near = slice(max(at - around, 0), at + around + 1)
    share = math.sqrt(min(max(slip.gap_s / PEAK_S, 1.0 / width), 1.0))  # of single values, that means are off
    std = float(np.median(slip.std_rad_s[near])) * share
    within = float(size_rad_s[near].std()) * share  # what it moves between samples
    found = largest(means, slip.noise_rad_s * share, width)
    below = CREST_RATIO * float(np.median(slip.bend_rad_s[near]))
    slope = float(np.ptp(size_rad_s[near])) / (INDEX_GRID_S * max(len(size_rad_s[near]) - 1, 1))
    rows = (round(gaps_s[0] / INDEX_GRID_S), len(means) - 1 - round(gaps_s[1] / INDEX_GRID_S))
    edge_s = gaps_s[0] if at <= rows[0] else gaps_s[1] if at >= rows[1] else 0.0
    change = AGE_STD_S * float(np.abs(slip.acceleration_rad_s2[near]).mean())
    return IndexValue(found.value + below, math.hypot(std, change, within, UNIFORM * edge_s * slope))


def _reslip(slip_rad_s: FloatArray, is_pressed: BoolArray) -> float:
    """Return the largest slip under load after it had begun and ended once [rad/s]: stick-slip, if there is much.

    Slip has begun when it is as large as three quarters of the largest: as a clutch bites, its shaft swings. It has
    ended when the clutch sticks, not as it passes zero. A clutch that was let go in between begins anew, and so does
    one that is let slip for long. Where there is no such stretch it is the least slip of all.
    """
    pressed_rad_s = np.where(is_pressed, slip_rad_s, 0.0)
    has_begun = ~(pressed_rad_s <= max(SLIP_RAD_S, 0.75 * float(pressed_rad_s.max())))
    is_stuck = is_pressed & (slip_rad_s < STUCK_RAD_S)
    first = _first_run(is_stuck, int(has_begun.argmax()), STUCK_ROWS) if has_begun.any() else len(slip_rad_s)
    stop = _first_run(~is_pressed, first + STUCK_ROWS, LET_GO_ROWS)
    if first >= stop:
        return 0.0
    slip_rad_s, pressed_rad_s = slip_rad_s[first:stop], pressed_rad_s[first:stop]
    edges = np.flatnonzero(np.diff(slip_rad_s >= STUCK_RAD_S, prepend=False))
    stretches = edges[: len(edges) // 2 * 2].reshape(-1, 2).tolist()  # without the one that does not end
    swings = [float(pressed_rad_s[begin:end].max()) for begin, end in stretches if end - begin <= SWING_ROWS]
    return max(swings, default=float(np.fmin.reduce(slip_rad_s, initial=STUCK_RAD_S)))


def _first_run(values: BoolArray, start: int, length: int) -> int:
    """Return the first row from ``start`` on from which so many are true; the row after the last if there is none."""
    if len(values) - start < length:
        return len(values)
    rows = np.flatnonzero(np.convolve(values[start:], np.ones(length, np.int64), "valid") == length)
    return start + int(rows[0]) if len(rows) else len(values)


def _pressed(grid: _Grid, calibration: Calibration) -> BoolArray:
    """Return where the clutch of the gear carries load, shape (n,); everywhere if nothing tells."""
    pressure_pa = grid.values.get(PRESSURES[grid.clutch - 1])
    if pressure_pa is not None:
        return pressure_pa > calibration.clutches[grid.clutch - 1].touch_pressure_pa + LOADED_PA
    asked_nm = grid.values.get(_COMMANDS[grid.clutch - 1])
    return np.ones(len(grid.t_s), np.bool_) if asked_nm is None else asked_nm > LOADED_NM


def _asked(grid: _Grid) -> tuple[FloatArray, FloatArray, bool] | None:
    """Return the torques asked of the on-coming and of the off-going clutch, and whether their signs are the slip's."""
    on, off = grid.values.get(_COMMANDS[grid.clutch - 1]), grid.values.get(_COMMANDS[2 - grid.clutch])
    if on is not None and off is not None:
        return on, off, False
    total = grid.values.get(Signal.CLUTCH_TORQUE)
    return None if total is None else (total, np.zeros(len(total)), True)


def _is_released(off_nm: FloatArray, on_nm: FloatArray, off_rad_s: FloatArray | None) -> BoolArray:
    """Return where the off-going clutch carries nothing: asked for next to nothing, and not locked where that shows."""
    is_released = np.abs(off_nm) < RELEASED_RATIO * np.maximum(np.abs(on_nm), MIN_TORQUE_NM)
    return is_released if off_rad_s is None else is_released & (np.abs(off_rad_s) > SLIP_RAD_S)


def _inertia_nm(slip: Slip, calibration: Calibration) -> FloatArray:
    """Return the torque that speeds up engine and clutch hub [N m]."""
    side = calibration.input_side
    return (side.engine_inertia_kg_m2 + side.hub_inertia_kg_m2) * slip.acceleration_rad_s2


def _torque_capacity(
    grid: _Grid, slip: Slip, off_rad_s: FloatArray | None, calibration: Calibration
) -> IndexValue | NotMeasured:
    """Return the torque transmitted at slip over the one asked for, and its standard deviation; docs/model.md eq. (I4).

    Least squares through the origin; the deviation adds the scatter of the residuals, the gain and the offset of the
    engine torque, and the inertia.
    """
    asked = _asked(grid)
    if asked is None or grid.engine_nm is None:
        return NotMeasured.SIGNAL_MISSING
    on_nm, off_nm, is_signed = asked
    is_released = _is_released(off_nm, on_nm, off_rad_s)
    rows = np.flatnonzero((np.abs(slip.rad_s) > SLIP_RAD_S) & (np.abs(on_nm) > MIN_TORQUE_NM) & is_released)
    if len(rows) * INDEX_GRID_S < MIN_WINDOW_S:
        return NotMeasured.SLIP_TOO_SHORT
    asked_nm = on_nm[rows] if is_signed else on_nm[rows] * np.where(slip.rad_s[rows] > 0.0, 1.0, -1.0)
    engine_nm, inertia_nm = grid.engine_nm[rows], _inertia_nm(slip, calibration)[rows]
    square = float(asked_nm @ asked_nm)
    by_engine, by_offset, by_inertia = (
        float(asked_nm @ torque_nm) / square for torque_nm in (engine_nm, np.ones_like(asked_nm), inertia_nm)
    )
    ratio = by_engine - by_inertia
    scatter = math.sqrt(float(np.mean((engine_nm - inertia_nm - ratio * asked_nm) ** 2)) / square)
    spread = calibration.uncertainty
    std = math.hypot(
        scatter * math.sqrt(CORRELATION_S / INDEX_GRID_S),
        spread.torque_gain_ratio * by_engine,
        spread.torque_offset_nm * by_offset,
        INERTIA_STD_RATIO * by_inertia,
    )
    if ratio < -STDS * std:  # a clutch drags its faster side along: none turns against its slip
        return NotMeasured.UNTRUSTED
    return IndexValue(ratio, std)


def _heat(
    grid: _Grid, slip: Slip, off_rad_s: FloatArray | None, capacity: IndexValue | NotMeasured, calibration: Calibration
) -> IndexValue | NotMeasured:
    """Return the heat of slip in the on-coming clutch [J]; docs/model.md eq. (I6).

    Once the off-going clutch is released, the on-coming one carries the engine's torque less what its inertia takes.
    Before, it carries what is asked of it, by the capacity of this event; where that is not
    told, nobody knows which part.
    """
    if grid.engine_nm is None:
        return NotMeasured.SIGNAL_MISSING
    spread = calibration.uncertainty
    inertia_nm = _inertia_nm(slip, calibration)
    whole_nm = grid.engine_nm - inertia_nm
    is_slipping = np.abs(slip.rad_s) > SLIP_RAD_S
    asked = _asked(grid)
    is_alone = np.ones(len(grid.t_s), np.bool_)
    handed_nm, std_handed, late_nm = 0.5 * np.abs(whole_nm), 2.0 * UNIFORM, np.zeros_like(whole_nm)
    if asked is not None and not asked[2]:
        is_alone = _is_released(asked[1], asked[0], off_rad_s)
        known = capacity if isinstance(capacity, IndexValue) else IndexValue(1.0, CAPACITY_STD)
        followed_nm = np.interp(grid.t_s - COMMAND_LAG_S, grid.t_s, asked[0])
        handed_nm, std_handed = known.value * np.maximum(followed_nm, 0.0), known.std
        late_nm = known.value * np.gradient(followed_nm, INDEX_GRID_S) * COMMAND_LAG_S
    elif off_rad_s is not None:
        is_alone = np.abs(off_rad_s) > SLIP_RAD_S
    size, sign = np.abs(slip.rad_s), np.where(slip.rad_s > 0.0, 1.0, -1.0)
    alone, shared = np.where(is_slipping & is_alone, size * sign, 0.0), np.where(is_slipping & ~is_alone, size, 0.0)
    by_engine, by_inertia, by_offset, by_latency = (
        float(alone @ torque_nm) * INDEX_GRID_S
        for torque_nm in (grid.engine_nm, inertia_nm, np.ones_like(size), np.gradient(grid.engine_nm, INDEX_GRID_S))
    )
    by_handing = float(shared @ handed_nm) * INDEX_GRID_S
    noise = float(np.sqrt(np.sum((whole_nm * slip.std_rad_s * (is_slipping & is_alone)) ** 2)))
    std = math.hypot(
        spread.torque_gain_ratio * by_engine,
        INERTIA_STD_RATIO * by_inertia,
        spread.torque_offset_nm * by_offset,
        spread.torque_latency_s * by_latency,
        std_handed * by_handing,
        float(shared @ late_nm) * INDEX_GRID_S,
        noise * INDEX_GRID_S * math.sqrt(max(slip.gap_s / INDEX_GRID_S, 1.0)),
    )
    return IndexValue(max(by_engine - by_inertia + by_handing, 0.0), std)


CAPACITY_STD: Final = 0.2  # of the torque a clutch transmits over the one asked for, before anything tells it
