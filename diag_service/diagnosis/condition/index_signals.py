"""What the signals of an event tell for its indices, and how well: scatter, gaps, slip, ratios, the car's speed.

All deviations come from the event itself: how far its samples are apart, their resolution, how much they scatter about
what is smooth. docs/model.md, indices of a shift.
"""

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Series
from clutch_model.calibration import Calibration, clutch_of_gear
from clutch_model.units import NS_PER_S
from clutch_results.event_kinds import NotMeasured
from diag_service.diagnosis.alignment import segment_centres_s
from diag_service.diagnosis.columns import Columns, GearRatios, Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.shifts.shifts import SHAFTS

UNIFORM: Final = 1.0 / math.sqrt(12.0)  # deviation of what lies anywhere in an interval of length 1
NORMAL_MEDIAN: Final = 0.6745  # of the size of normal numbers, in deviations
AGE_STD_S: Final = 0.01 / math.sqrt(3.0)  # of a speed as it is sent: controllers work every 10 ms, it is 0 to 10 ms old
APART_STD_S: Final = 0.01 * UNIFORM  # by which two speeds of one bus are apart: half a cycle either way
SPAN_S: Final = 0.5  # before and after an event, over which a gear's ratio is looked at
LEAST_SPAN_S: Final = 0.05  # less tells no ratio
LEAST_ROWS: Final = 3
STATED_RATIO_STD: Final = 0.005  # relative: tyres wear, and descriptions round
SETTLED_RAD_S: Final = 3.0  # rms: a locked driveline swings by so much about the ratio of its gear
DRIFT_RAD_S: Final = 2.0  # of engine speed less ratio times output over the span: more is slip
SWING_S: Final = 0.06  # half a period of a driveline, at about 8 Hz: for so long deviations from the ratio are alike
LEAST_TURNING_RAD_S: Final = 5.0  # of an output shaft: below it a ratio says nothing
LEAST_CAR_M_S: Final = 0.5  # likewise
LEAST_STEP_RATIO: Final = 0.1  # from gear to gear: neighbours are 15 % apart
BEHIND: Final = (Signal.OUTPUT_SPEED, Signal.VEHICLE_SPEED)  # speeds behind the gears, the better one first
WHEELS: Final = (Signal.WHEEL_FL_SPEED, Signal.WHEEL_FR_SPEED, Signal.WHEEL_RL_SPEED, Signal.WHEEL_RR_SPEED)
GEARS: Final = (Signal.TARGET_GEAR, Signal.CURRENT_GEAR, Signal.SHIFT_ACTIVE)


class Samples(NamedTuple):
    """One signal of an event, two samples or more."""

    t_s: FloatArray  # (n,) since the start of the event, rising
    value: FloatArray  # (n,)
    std: float  # of a single value: its scatter and resolution

    @classmethod
    def of(cls, series: Series | None, origin_ns: int) -> "Samples | None":
        """Return the samples of a column, None where there are fewer than two times."""
        if series is None or len(series.t_ns) < 2:
            return None
        t_s = (series.t_ns - origin_ns) / NS_PER_S
        is_new = np.diff(t_s, prepend=-math.inf) > 0.0
        t_s, value = t_s[is_new], series.value[is_new]
        return None if len(t_s) < 2 else cls(t_s, value, scatter(value))

    @property
    def gap_s(self) -> float:
        """From one sample to the next, as a rule."""
        return _middle(np.diff(self.t_s))

    @property
    def is_fine(self) -> bool:
        """Of the car's speed: whether it tells jerk to 15 m/s3, which is about as much as passengers feel."""
        return self.std * math.sqrt(self.gap_s) < COARSE_M_S

    def gap_at_s(self, t_s: float) -> float:
        """Return how far the samples on either side of a moment are apart [s]."""
        place = int(np.clip(self.t_s.searchsorted(t_s), 1, len(self.t_s) - 1))
        return float(self.t_s[place] - self.t_s[place - 1])

    def at(self, t_s: FloatArray) -> FloatArray:
        """Return what it reads at some times, linear between samples, constant beyond them."""
        return np.asarray(np.interp(t_s, self.t_s, self.value), np.float64)


def scatter(value: FloatArray) -> float:
    """Return the standard deviation of single samples about what is smooth, resolution included.

    White noise of variance s^2 gives differences of order k the variance s^2 * (2k over k); a course gives lower
    orders more, so the least one counts. Their median leaves out jumps. The resolution is the least step there is.
    By n samples it is known to about sqrt(2/n): it is taken larger, so that two of it hold what two of Student's do.
    """
    moved = np.abs(np.diff(value))
    step = float(moved[moved > 0.0].min(initial=math.inf))
    stds = [
        _middle(np.abs(np.diff(value, order))) / NORMAL_MEDIAN / math.sqrt(math.comb(2 * order, order))
        for order in (2, 3, 4)
        if len(value) > order + 2
    ]
    noise = min(stds, default=float(moved.max(initial=0.0))) * (1.0 + 4.0 / len(value))
    return math.hypot(noise, step * UNIFORM if math.isfinite(step) else 0.0)


def _middle(values: FloatArray) -> float:
    """Return the upper median: of a few hundred numbers sorting is the fastest way."""
    return float(np.sort(values)[len(values) // 2])


class Value(NamedTuple):
    """A number and its standard deviation."""

    value: float
    std: float


class Slip(NamedTuple):
    """Slip of one clutch on the grid of the indices."""

    rad_s: FloatArray  # (n,) input side less output side
    std_rad_s: FloatArray  # (n,) of single values: scatter, resolution, what lies between samples, the ratio
    noise_rad_s: float  # of it what each sample has of its own
    bend_rad_s: FloatArray  # of it what lies between samples
    acceleration_rad_s2: FloatArray  # (n,) of the input side
    gap_s: float  # between samples of the side that has fewer


@dataclass(frozen=True, slots=True, kw_only=True)
class Ratios:
    """Engine speed over a speed behind the gears while the old gear and the new one are locked."""

    over: Signal | None = None
    before: Value | None = None
    after: Value | None = None


def stated_ratios(event: Event, gears: GearRatios | None) -> Ratios:
    """Return the ratios of the gears before and after an event as a description of the car has them."""
    if gears is None:
        return Ratios()
    before, after = (
        Value(gears.ratios[gear - 1], STATED_RATIO_STD * gears.ratios[gear - 1])
        if 1 <= gear <= len(gears.ratios)
        else None
        for gear in (event.from_gear, event.to_gear)
    )
    return Ratios(over=gears.over, before=before, after=after)


def gear_ratios(event: Event, engine: Samples, duration_s: float, gaps_s: tuple[float, float]) -> Ratios:
    """Return the ratios of the gears before and after an event, each where engine and output turn together.

    ``gaps_s`` are those of the samples by which its beginning and its end are known.
    """
    for over in BEHIND:
        behind = Samples.of(event.columns.get(over), event.start_ns)
        if behind is None:
            continue
        least = LEAST_TURNING_RAD_S if over is Signal.OUTPUT_SPEED else LEAST_CAR_M_S
        before = _ratio(engine, behind, least, -SPAN_S, -gaps_s[0], is_late=False)
        after = _ratio(engine, behind, least, max(duration_s - SPAN_S, 0.0), math.inf, is_late=True)
        if before is not None and after is not None and _is_one_gear(event, before, after):
            after = None  # no clutch has closed: the old gear still turns
        return Ratios(over=over, before=before, after=after)
    return Ratios()


def _is_one_gear(event: Event, before: Value, after: Value) -> bool:
    return event.from_gear != event.to_gear and abs(after.value / before.value - 1.0) < LEAST_STEP_RATIO


def _ratio(
    engine: Samples, behind: Samples, least: float, begin_s: float, end_s: float, *, is_late: bool
) -> Value | None:
    """Return engine speed over another one, least squares over the longest stretch at one end in which it stays."""
    low, high = max(begin_s, behind.t_s[0]), min(end_s, behind.t_s[-1])
    rows = np.flatnonzero((engine.t_s >= low) & (engine.t_s <= high))
    t_s, turning = engine.t_s[rows], engine.value[rows]
    over = behind.at(t_s)
    while len(t_s) >= LEAST_ROWS and t_s[-1] - t_s[0] >= LEAST_SPAN_S and over.min() > least:
        ratio = float(turning @ over / (over @ over))
        rest = turning - ratio * over
        span_s = float(t_s[-1] - t_s[0])
        rms = float(np.sqrt(np.mean(rest**2)))
        along = (t_s - t_s.mean()) / span_s
        drift = float(along @ rest / (along @ along))
        noise = math.hypot(engine.std, ratio * behind.std)
        drift_std = noise / math.sqrt(float(along @ along))
        if rms < SETTLED_RAD_S + noise and abs(drift) < DRIFT_RAD_S + 2.0 * drift_std:
            count = max(min(len(t_s), span_s / SWING_S), 1.0)
            slope = abs(float(along @ (over - over.mean()) / (along @ along))) / span_s
            mean = float(over.mean())
            std = math.hypot(
                math.sqrt(max(rms**2 - noise**2, 0.0) / count),
                drift * UNIFORM / math.sqrt(count),
                noise / math.sqrt(len(t_s)),
                ratio * slope * APART_STD_S,
            )
            return Value(ratio, std / mean)
        shorter = max(len(t_s) // 5, 1)
        part = slice(shorter, None) if is_late else slice(None, -shorter)
        t_s, turning, over = t_s[part], turning[part], over[part]
    return None


def engine_samples(event: Event, calibration: Calibration) -> Samples | None:
    """Return the speed of the clutches' input side; that of an engine belongs to the middle of a crank segment."""
    hub = Samples.of(event.columns.get(Signal.HUB_SPEED), event.start_ns)
    if hub is not None:
        return hub
    engine = Samples.of(event.columns.get(Signal.ENGINE_SPEED), event.start_ns)
    if engine is None:
        return None
    centres_s = segment_centres_s(engine.t_s, engine.value, calibration.input_side.crank_segment_rad)
    return engine._replace(t_s=np.maximum.accumulate(centres_s))


def is_one_shaft(event: Event) -> bool:
    """Return whether both gears are on one shaft: until the new one is engaged, no speed behind the gears tells it."""
    return (
        event.from_gear != event.to_gear
        and min(event.from_gear, event.to_gear) >= 1
        and clutch_of_gear(event.from_gear) == clutch_of_gear(event.to_gear)
    )


def shaft_samples(event: Event, gear: int, ratio: Value | None, over: Signal | None) -> tuple[Samples, float] | None:
    """Return the speed of a gear's input shaft, by a ratio if need be, and the relative error that samples share."""
    shaft = None
    if gear >= 1:
        shaft = Samples.of(event.columns.get(SHAFTS[clutch_of_gear(gear) - 1]), event.start_ns)
    if shaft is None and gear == event.to_gear:
        shaft = Samples.of(event.columns.get(Signal.INPUT_SPEED), event.start_ns)
    if shaft is not None:
        return shaft, 0.0
    if is_one_shaft(event):
        return None
    behind = None if over is None else Samples.of(event.columns.get(over), event.start_ns)
    if behind is None or ratio is None:
        return None
    return Samples(behind.t_s, ratio.value * behind.value, ratio.value * behind.std), ratio.std / ratio.value


def slip_on(
    grid_s: FloatArray, engine: Samples, acceleration_rad_s2: FloatArray, shaft: Samples, shared: float
) -> Slip:
    """Return the slip between both sides on a grid, and how sure it is; ``shared`` is a relative error of the shaft."""
    turning, output = engine.at(grid_s), shaft.at(grid_s)
    between = np.hypot(bend(engine, grid_s), bend(shaft, grid_s))
    noise = math.hypot(engine.std, shaft.std)
    std = np.sqrt(noise**2 + between**2 + (shared * output) ** 2)
    return Slip(turning - output, std, noise, between, acceleration_rad_s2, max(engine.gap_s, shaft.gap_s))


def bend(samples: Samples, at_s: FloatArray) -> FloatArray:
    """Return by how much a smooth curve may leave the straight line between samples, one deviation, shape (n,).

    A parabola leaves its chord by h^2*y''/8 at most, rms over the chord sqrt(1/120) of h^2*y''; its second difference
    is h^2*y'' and holds noise too, of which half is taken off: it is known badly.
    """
    if len(samples.t_s) < 3:
        return np.full(len(at_s), float(np.abs(np.diff(samples.value)).max()) * UNIFORM)
    second = np.abs(np.diff(samples.value, 2))
    second = np.sqrt(np.maximum(second**2 - 3.0 * samples.std**2, 0.0))
    both = np.maximum(np.pad(second, (0, 1), mode="edge"), np.pad(second, (1, 0), mode="edge"))  # of each interval
    place = np.clip(samples.t_s.searchsorted(at_s) - 1, 0, len(both) - 1)
    return np.asarray(both[place] / math.sqrt(120.0))


SMOOTH_S: Final = 0.06  # half width of the parabola that differentiates the engine speed
LEAST_APART: Final = 1e-6  # a determinant: three samples a few milliseconds apart have as much


def slopes_at(samples: Samples, at_s: FloatArray) -> FloatArray:
    """Return the slope of a parabola, fitted by least squares, around each of some rising times; 0 by fewer than 3.

    So it is of samples of fewer than 3 times: a log may tell them by the tenth of a second.
    """
    t_s, value = samples.t_s, samples.value
    first, stop = t_s.searchsorted(at_s - SMOOTH_S), t_s.searchsorted(at_s + SMOOTH_S)
    places = first[:, np.newaxis] + np.arange((count := stop - first).max(initial=1))
    is_near = places < stop[:, np.newaxis]
    places = np.minimum(places, len(t_s) - 1)
    x = (t_s[places] - at_s[:, np.newaxis]) / SMOOTH_S * is_near
    y = value[places] * is_near
    x1, x2, x3, x4 = [np.sum(x**power, axis=1) for power in range(1, 5)]
    y0, xy, xxy = [np.sum(x**power * y, axis=1) for power in range(3)]
    whole = count * (x2 * x4 - x3 * x3) - x1 * (x1 * x4 - x2 * x3) + x2 * (x1 * x3 - x2 * x2)  # Cramer's rule
    slope = count * (xy * x4 - x3 * xxy) - y0 * (x1 * x4 - x3 * x2) + x2 * (x1 * xxy - xy * x2)
    rows, slopes = np.flatnonzero((count >= 3) & (whole > LEAST_APART)), np.zeros(len(at_s))
    slopes[rows] = slope[rows] / whole[rows] / SMOOTH_S
    return slopes


def car_speed(columns: Columns, origin_ns: int) -> Samples | None:
    """Return the speed of the car [m/s] by the signal that tells its changes best; None if nothing does.

    Wheels that drive turn faster than the car by what their tyres slip, which goes with the force: they stand in where
    the car's own speed is too coarse. An output shaft swings by itself and tells no jerk of the car.
    """
    own = Samples.of(columns.get(Signal.VEHICLE_SPEED), origin_ns)
    wheels = [one for signal in WHEELS if (one := Samples.of(columns.get(signal), origin_ns)) is not None]
    together = [] if own is None else [own._replace(std=own.std * math.sqrt(_held_count(own.value)))]
    if wheels and all(np.array_equal(one.t_s, wheels[0].t_s) for one in wheels):
        mean = np.mean([one.value for one in wheels], axis=0)
        std = math.sqrt(sum(one.std**2 for one in wheels)) / len(wheels)
        together.append(Samples(wheels[0].t_s, mean, std * math.sqrt(_held_count(wheels[0].value))))
    moving = [one for one in together if np.count_nonzero(np.diff(one.value)) >= LEAST_CHANGES] or together[:0]
    fine = [one for one in moving if one.std * math.sqrt(one.gap_s) < FINE_M_S]
    return min(fine[:1] or moving, key=lambda one: one.std * math.sqrt(one.gap_s), default=None)


FINE_M_S: Final = 0.05 * math.sqrt(0.01)  # by samples every 10 ms: a speed that tells jerk to 5 m/s3
COARSE_M_S: Final = 3.0 * FINE_M_S


LEAST_CHANGES: Final = 4  # of a speed around an event: of what stays nobody knows how coarse it is


def _held_count(value: FloatArray) -> float:
    """Return for how many samples in a row a value stays, in the mean: what rounding makes of them is one error."""
    return len(value) / (1.0 + np.count_nonzero(np.diff(value)))


SLOPE_S: Final = 0.08  # half width of the straight line that differentiates the car's speed
JERK_S: Final = 0.1  # over which a change of acceleration is felt as one
JERK_GRID_S: Final = 0.01
LEAST_KNOWN_RATIO: Final = 0.8  # of the event: in what is missing the jerk may have been larger
LEAST_SPREAD_RATIO: Final = 0.25  # of the spread of samples all over the line
ROUNDING_S: Final = 1e-6  # of times: a sample at the very end of a line belongs to it


def jerk_of(car: Samples, begin_s: float, end_s: float) -> Value | NotMeasured:
    """Return the largest change of the car's acceleration within 0.1 s, over that time [m/s3], and its deviation.

    Acceleration is the slope of a straight line through the samples of 0.16 s; docs/model.md eq. (I6).
    """
    at_s = np.arange(begin_s, end_s, JERK_GRID_S)
    jerks = (_slopes_of_lines(car, at_s) - _slopes_of_lines(car, at_s - JERK_S)) / JERK_S
    known = np.flatnonzero(~np.isnan(jerks))
    if len(known) < LEAST_KNOWN_RATIO * len(at_s):
        is_slow = car.gap_s * (LEAST_ROWS - 1) > 2.0 * SLOPE_S
        return NotMeasured.SAMPLED_TOO_SLOWLY if is_slow else NotMeasured.SAMPLES_MISSING
    most_s = float(at_s[known[int(np.abs(jerks[known]).argmax())]])
    weights = (_line_weights(car.t_s, most_s) - _line_weights(car.t_s, most_s - JERK_S)) / JERK_S
    single = math.hypot(car.std, _middle(bend(car, at_s)))
    std = single * float(np.sqrt(np.sum(weights**2)))
    return largest(np.abs(jerks[known]), std, 0.5 * JERK_S / JERK_GRID_S)  # either sign is a number of its own


def largest(sizes: FloatArray, std: float, width: float) -> Value:
    """Return the largest of some numbers with one deviation, freed of what the choice among like ones adds.

    ``width`` neighbours are one number. The largest of n normal ones is beyond their mean by their deviation times the
    quantile (n - 3/8)/(n + 1/4) (Blom).
    """
    most = float(sizes.max())
    count = float(np.count_nonzero(sizes > most - 2.0 * std)) / width
    beyond = NormalDist().inv_cdf((count - 0.375) / (count + 0.25)) if count > 1.0 else 0.0
    return Value(max(most - beyond * std, 0.0), std)


def _slopes_of_lines(samples: Samples, at_s: FloatArray) -> FloatArray:
    """Return the slope of the straight line through the samples around each time, shape (n,); NaN for few."""
    origin_s = float(at_s[0])
    t_s, value = samples.t_s - origin_s, samples.value - float(samples.value[0])
    first, stop = (t_s.searchsorted(at_s - origin_s + reach) for reach in (-SLOPE_S - ROUNDING_S, SLOPE_S + ROUNDING_S))
    sums = np.zeros((4, len(t_s) + 1))
    np.cumsum([t_s, value, t_s * t_s, t_s * value], axis=1, out=sums[:, 1:])
    t1, v1, t2, tv = sums[:, stop] - sums[:, first]
    count = np.maximum(stop - first, 1)
    square = t2 - t1 * t1 / count
    # Of samples on one side alone the line would be drawn on beyond them.
    is_told = (count >= LEAST_ROWS) & (square > LEAST_SPREAD_RATIO * count * SLOPE_S**2 / 3.0)
    return np.where(is_told, (tv - t1 * v1 / count) / np.where(is_told, square, 1.0), np.nan)


def _line_weights(t_s: FloatArray, at_s: float) -> FloatArray:
    """Return by what each sample enters the slope of the line around one time, shape (n,)."""
    is_near = np.abs(t_s - at_s) <= SLOPE_S + ROUNDING_S
    centred_s = np.where(is_near, t_s - t_s[is_near].mean(), 0.0)
    return np.asarray(centred_s / (centred_s @ centred_s))


JUDDER_HZ: Final = (5.0, 20.0)
LEAST_RATE_HZ: Final = 40.0  # twice the upper end of the band
LEAST_JUDDER_S: Final = 0.4  # two periods of its lower end


def judder_of(slip: Slip, is_slipping: BoolArray, grid_s: float) -> Value | NotMeasured:
    """Return the root mean square of slip between 5 and 20 Hz from the first slip to the last [rad/s].

    A parabola is taken off, what is left is taken apart into cosines; docs/model.md eq. (I7).
    """
    if slip.gap_s > 1.0 / LEAST_RATE_HZ:
        return NotMeasured.SAMPLED_TOO_SLOWLY
    rows = np.flatnonzero(is_slipping)
    first, stop = (int(rows[0]), int(rows[-1]) + 1) if len(rows) else (0, 0)
    count = stop - first
    if count * grid_s < LEAST_JUDDER_S:
        return NotMeasured.SLIP_TOO_SHORT
    square, share = band_square(slip.rad_s[first:stop], grid_s)
    noise = _middle(slip.std_rad_s[first:stop]) * math.sqrt(share * slip.gap_s / grid_s)
    components = 2.0 * count * grid_s * (JUDDER_HZ[1] - JUDDER_HZ[0])
    lost = 1.0 - float(np.sinc(0.5 * sum(JUDDER_HZ) * slip.gap_s)) ** 2  # by lines between samples, mid-band
    rms = math.sqrt(max(square - noise**2, 0.0))
    std = math.hypot(noise / math.sqrt(components), noise**2 / (2.0 * math.sqrt(square) + noise), lost * rms)
    return Value(rms, std)


def band_square(slip_rad_s: FloatArray, grid_s: float) -> tuple[float, float]:
    """Return the mean square of even samples between 5 and 20 Hz, a parabola taken off, and the band's share of all."""
    count = len(slip_rad_s)
    place = np.linspace(-1.0, 1.0, count)
    rest = slip_rad_s - slip_rad_s.mean()
    for course in (place, place**2 - np.mean(place**2)):  # each is orthogonal to the others
        rest = rest - course * float(course @ rest / (course @ course))
    first, last = math.ceil(2.0 * JUDDER_HZ[0] * count * grid_s), math.floor(2.0 * JUDDER_HZ[1] * count * grid_s)
    mirrored = np.fft.rfft(np.concatenate([rest, rest[::-1]]))[first : last + 1]  # cosines, by their phases
    return float(0.5 * np.sum(np.abs(mirrored / count) ** 2)), (last - first + 1) / count
