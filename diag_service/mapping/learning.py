"""What drives tell of a vehicle that nobody described: gears, ratios, clutches, touch points, lags; a profile of them.

Nothing is claimed that the drives do not show: a gear that was not driven with its clutch closed is absent, a lag needs
a commanded pressure. Every value has the standard deviation that its evidence allows, and says where it is from.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Database

from canlog.arrays import BoolArray, FloatArray, Int64Array, Series
from canlog.database.addressing import NOBODY, why_wrong
from canlog.database.signal_columns import columns_database
from canlog.decode.codec import Codec
from canlog.logs import STANDARD_INPUT, read_log, shown_name, table_columns
from canlog.logs.reading import Watch
from canlog.logs.streams import never
from clutch_model.calibration import clutch_of_gear
from clutch_model.units import NS_PER_S, bar_from_pa
from clutchdiag_io.people import digits
from clutchdiag_io.program import legible
from dbc.contract import DBC_PATH
from diag_service.diagnosis.columns import NO_SAMPLES, ColumnBatch, GearRatios, Signal
from diag_service.diagnosis.prediction import LEAST_CERTAIN, LEAST_EVENTS, LEAST_OF_CLUTCH, fitted
from diag_service.diagnosis.slip_phase import HELD_PA, SlipPhase
from diag_service.errors import StoppedError
from diag_service.mapping import proposal
from diag_service.mapping.contest import MOST_CANDIDATES, Best, joined, judged, needs_tracks, thinned
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.interpretation import open_database
from diag_service.mapping.liveness import COUPLED, DEMANDS, LEAST_RECORDED, Liveness, StillSignal
from diag_service.mapping.mapped_messages import is_of_lockup, missing_for_next, reach_in_words, tier_of
from diag_service.mapping.profile import Profile, SignalSource
from diag_service.mapping.proposal import LEAST_SAMPLES, LEAST_SPEED, GearRatio, densest, is_complete

MOST_ROWS: Final = 400_000  # that are kept of all drives: beyond, every second one goes
SETTLED_S: Final = 0.25  # after a stretch began: before, the clutch that takes over may still slip
STRETCH_S: Final = 1.0  # samples that are further apart are of another stretch, whose error is its own
LEAST_CLUSTER: Final = 0.01  # of all samples lie in the band of a gear that is driven, where no signal names it
APART_RATIO: Final = 0.06  # neighbouring gears are further apart
CLOSED_PA: Final = 0.3e5  # the pressure of a closed clutch is higher by more than this
STEADY_PA: Final = 0.15e5  # spread of a pressure that is held
STANDING: Final = 0.5  # rad/s or m/s
HOLD_STD_PA: Final = 1.0e4  # controllers hold a clutch that near to its touch point
TYPE_STD_PA: Final = 1.5e4  # by which the touch points of both clutches differ
MOST_LAG_S: Final = 0.12
AGE_RATIO: Final = 0.65  # of a period: deviation of the age of a pressure, up to two old, beside that of a command
RATE_S: Final = 0.02  # before and after a sample: its rate is that between them
COMMAND_STEP_S: Final = 0.08  # over which the step of a command is taken
GAIN_LAW_RATIO: Final = 0.15  # by which gains of emulated cars are off: where torque is cut, they look like inertia
LEAST_CLOSED_PA: Final = 2.5e5  # beyond the touch point of any type
MOVING_PA: Final = 0.5e5  # a command that moves by less tells no lag
SURE: Final = 0.9  # share of the samples
PRESSURES: Final = (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE)
BEHIND: Final = (Signal.OUTPUT_SPEED, Signal.VEHICLE_SPEED)
MS_PER_S: Final = 1e3
LOADS: Final = (Signal.INJECTION_TIME, Signal.ENGINE_TORQUE)  # beside injection, torque may be modelled by it
HARDEST: Final = 0.95  # quantile of loads over pressure: a few rows may be damaged
COMMANDS: Final = (Signal.CLUTCH1_PRESSURE_COMMAND, Signal.CLUTCH2_PRESSURE_COMMAND)
GEARS: Final = (Signal.TARGET_GEAR, Signal.CURRENT_GEAR)
BAND, MOST_BAND = 0.03, 0.09  # of ratios around a gear's: a speed that grows moves them by that, rough ground by more
ROUNDS: Final = 4  # until a band is where its ratios are
GROWTH_S: Final = 0.8  # over which the gain of speed is a line
MOST_GROWTH_1_S: Final = 1.7  # of the logarithm of the speed
FASTEST: Final = 1e5  # rad/s or m/s: no damaged value hides all that come behind it
DAMAGED_ROWS: Final = 5  # of which two that are damaged tell no gain of speed
OUTLYING: Final = 4.0
LEAST_SCATTER: Final = 1e-12  # of samples without noise
SPEED_RATIO: Final = 1e-3  # by which two speeds' scales differ: whole revolutions that are cut off, at 1,000 rpm
OWN_SKEW_S: Final = 0.02  # by which the skew of a gear differs from that of all: a driveline winds up (40 drawn cars)
_TIME, _GEAR, _ENGINE, _OVER, _GROWTH, _LOAD, _FIRST = range(7)  # columns that are kept; pressures are the last


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnedValue:
    """A value, its standard deviation, and what it is from."""

    value: float
    std: float
    origin: str

    @property
    def is_assumed(self) -> bool:
        """Whether no log tells it."""
        return self.origin.startswith("assumed")


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnedGear:
    """A gear as it was driven; ``clutch`` is None where pressures do not tell it."""

    ratio: GearRatio
    clutch: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnedVehicle:
    """What some drives told; what is absent they did not tell."""

    over: Signal
    gears: Mapping[int, LearnedGear]
    are_named: bool  # the gears, by a signal; else they are numbered from the highest ratio that was driven
    touch_pa: Mapping[int, LearnedValue] = field(default_factory=dict)  # by clutch, as all that follows
    lag_s: Mapping[int, LearnedValue] = field(default_factory=dict)  # of a pressure behind its command
    gain_rad_s2_pa: Mapping[int, LearnedValue] = field(default_factory=dict)  # of the engine: friction up to scale
    rates_hz: Mapping[Signal, float] = field(default_factory=dict)  # at which signals came
    held_run: str = ""  # what a clutch carried where one gear alone was driven
    unclosed: Mapping[int, int] = field(default_factory=dict)  # samples of driven gears that tell no ratio

    @property
    def ratios(self) -> GearRatios | None:
        """The ratios of all gears; None if one is missing, or they do not fall."""
        told = {gear: self.gears[gear].ratio for gear in sorted(self.gears)}
        if not is_complete(told):
            return None
        return GearRatios(over=self.over, ratios=tuple(one.ratio for one in told.values()))

    def touch_point(self, clutch: int) -> LearnedValue | None:
        """Return where a clutch touches; one that is not held is taken for as wide apart as clutches of a type are."""
        other = 3 - clutch
        found, likely = self.touch_pa.get(clutch), self.touch_pa.get(other)
        if found is None and likely is not None:
            return replace(likely, std=TYPE_STD_PA, origin=f"assumed, as of clutch {other}")
        return found

    @property
    def is_swapped(self) -> bool:
        """Whether clutch 1 carries the even gears here: the pressures are named the other way round."""
        told = [one.clutch == clutch_of_gear(gear) for gear, one in self.gears.items() if one.clutch is not None]
        return self.are_named and bool(told) and not any(told)


class VehicleSurvey:
    """Takes up the signals of drives, in bounded memory."""

    def __init__(self, over: Signal) -> None:
        self._over = over
        self.rows: list[FloatArray] = []
        self._count, self._step, self._skip = 0, 1, 0
        self._lags: dict[int, list[float]] = {1: [], 2: []}
        self._periods_s: dict[Signal, list[float]] = {}
        self._has_gear = False
        self._load: Signal | None = None

    def add(self, batch: ColumnBatch) -> None:
        """Take up one batch."""
        for signal, series in batch.columns.items():
            if len(series.t_ns) > 1:
                self._periods_s.setdefault(signal, []).append(float(np.median(np.diff(series.t_ns))) / NS_PER_S)
        over, engine = batch.columns.get(self._over), batch.columns.get(Signal.ENGINE_SPEED)
        if over is None or engine is None or not len(over.t_ns) or not len(engine.t_ns):
            return
        gear = next(
            (batch.columns[one] for one in GEARS if one in batch.columns and len(batch.columns[one].t_ns)), None
        )
        self._has_gear |= gear is not None
        rows = np.full((len(over.t_ns), _FIRST + len(PRESSURES)), np.nan)
        rows[:, _TIME], rows[:, _OVER], rows[:, _ENGINE] = over.t_ns / NS_PER_S, over.value, _read(engine, over)
        rows[:, _GROWTH] = _growth_1_s(rows[:, _TIME], over.value)
        if gear is not None:
            known = np.searchsorted(gear.t_ns, over.t_ns, side="right") - 1
            rows[:, _GEAR] = np.where(known >= 0, gear.value[np.maximum(known, 0)], np.nan)
        if (load := next((one for one in LOADS if len(batch.columns.get(one, NO_SAMPLES).t_ns)), None)) is not None:
            rows[:, _LOAD], self._load = _read(batch.columns[load], over), load
        for place, (signal, asked) in enumerate(zip(PRESSURES, COMMANDS, strict=True)):
            if (pressure := batch.columns.get(signal)) is not None and len(pressure.t_ns):
                rows[:, _FIRST + place] = _read(pressure, over)
                if (command := batch.columns.get(asked)) is not None and len(command.t_ns):
                    self._lags[place + 1] += _lag_s(pressure, command)
        self._keep(rows)

    def _keep(self, rows: FloatArray) -> None:
        kept = rows[self._skip :: self._step]
        self._skip = (self._skip - len(rows)) % self._step
        self.rows.append(kept)
        self._count += len(kept)
        if self._count > MOST_ROWS:
            self.rows, self._step, self._skip = [np.concatenate(self.rows)[::2]], 2 * self._step, 0
            self._count = len(self.rows[0])

    def learned(self, phases: Sequence[SlipPhase] = (), logs: Sequence[str] = ()) -> LearnedVehicle:
        """Return what all that says; slip phases of power upshifts tell gains, ``logs`` of which drive each is.

        They tell no touch point: friction that falls with slip moves where a line through them meets zero by 20 to
        60 kPa, more than a type is known to.
        """
        rows = np.concatenate([np.empty((0, _FIRST + len(PRESSURES))), *self.rows])
        gears = _gears_of(rows, are_named=self._has_gear)
        held = {clutch: found for clutch in (1, 2) if (found := _held(rows, gears, clutch)) is not None}
        gains = _gains(phases, held, logs)
        lags = {clutch: np.array(found) for clutch, found in self._lags.items() if len(found) >= LEAST_EVENTS}
        rates_hz = {one: 1.0 / float(np.median(found)) for one, found in self._periods_s.items() if min(found) > 0.0}
        return LearnedVehicle(
            over=self._over,
            gears=gears,
            are_named=self._has_gear,
            touch_pa=held,
            lag_s={one: _middle(lag_s, 1.0 / rates_hz.get(PRESSURES[one - 1], np.inf)) for one, lag_s in lags.items()},
            gain_rad_s2_pa=gains,
            rates_hz=rates_hz,
            held_run=_held_run(rows, gears, self._load),
            unclosed=_unclosed(rows, gears) if self._has_gear else {},
        )


def _read(series: Series, other: Series) -> FloatArray:
    """Return a signal at the times of another one; unknown before and behind its own samples."""
    return np.interp(other.t_ns, series.t_ns, series.value, left=np.nan, right=np.nan)


def _growth_1_s(t_s: FloatArray, speed: FloatArray) -> FloatArray:
    """Return how fast the logarithm of a speed grows: the slope of a line through the speeds around each sample.

    Two speeds that scatter by 1.5 % say too little: their scatter would hide the skew of engine and wheels.
    """
    from scipy.ndimage import median_filter  # noqa: PLC0415 - it takes a while to load

    own, half_s = np.arange(len(t_s)), 0.5 * GROWTH_S  # three samples at least, however seldom they come
    first = np.minimum(t_s.searchsorted(t_s - half_s), np.maximum(own - 1, 0))
    behind = np.maximum(t_s.searchsorted(t_s + half_s, side="right"), np.minimum(own + 2, len(t_s)))
    late_s, told = t_s - t_s[0], median_filter(np.nan_to_num(np.clip(speed, -FASTEST, FASTEST)), DAMAGED_ROWS)
    totals = np.cumsum([late_s, told, late_s**2, late_s * told], axis=1)
    totals = np.concatenate([np.zeros((4, 1)), totals], axis=1)
    middle_s, middle, square_s2, product = (totals[:, behind] - totals[:, first]) / (behind - first)
    slope = (product - middle_s * middle) / np.maximum(square_s2 - middle_s**2, 1e-6)
    growth: FloatArray = slope / np.maximum(np.abs(middle), 1e-3)
    return growth


def _lag_s(pressure: Series, command: Series) -> list[float]:
    """Return by how much the pressure of a closed pack is behind its command, if that moves.

    For a lag of first order ``command - pressure = lag * d(pressure)/dt``; the command's own steps weigh both sides,
    because they hold no noise of the pressure. A pack that is being filled is behind by its oil.
    """
    t_s, wanted_pa = (command.t_ns - command.t_ns[0]) / NS_PER_S, command.value
    own_s = (pressure.t_ns - command.t_ns[0]) / NS_PER_S
    before_pa, read_pa, after_pa = (np.interp(t_s + late_s, own_s, pressure.value) for late_s in (-RATE_S, 0.0, RATE_S))
    open_count = np.concatenate(([0], np.cumsum(np.minimum(read_pa, wanted_pa) < LEAST_CLOSED_PA)))
    is_closed = open_count[t_s.searchsorted(t_s + MOST_LAG_S)] == open_count[t_s.searchsorted(t_s - MOST_LAG_S)]
    if np.count_nonzero(is_closed) < LEAST_SAMPLES or float(np.ptp(wanted_pa[is_closed])) < MOVING_PA:
        return []
    steps_pa = (wanted_pa - np.interp(t_s - COMMAND_STEP_S, t_s, wanted_pa))[is_closed]
    steps_pa -= steps_pa.mean()
    rate_pa_s = (after_pa - before_pa)[is_closed] / (2.0 * RATE_S)
    moved_pa2_s, behind_pa2 = float(steps_pa @ rate_pa_s), float(steps_pa @ (wanted_pa - read_pa)[is_closed])
    return [behind_pa2 / moved_pa2_s] if 0.0 < behind_pa2 < MOST_LAG_S * moved_pa2_s else []


def _middle(found: FloatArray, age_s: float) -> LearnedValue:
    """Return the lag of many commands; when the values of a message were read is unknown to two periods."""
    spread = 1.4826 * float(np.median(np.abs(found - np.median(found))))
    std = float(np.hypot(AGE_RATIO * age_s, spread / np.sqrt(len(found))))
    return LearnedValue(value=float(np.median(found)), std=std, origin="closed pressure behind its command")


def _gears_of(rows: FloatArray, *, are_named: bool) -> Mapping[int, LearnedGear]:
    moving = rows[rows[:, _OVER] > STANDING, _OVER]
    high = float(np.quantile(moving, 0.99, method="lower")) if len(moving) else 0.0  # one damaged value says nothing
    is_fast = rows[:, _OVER] > LEAST_SPEED * high
    is_steady = np.abs(rows[:, _GROWTH]) < MOST_GROWTH_1_S  # a line says nothing of a start from rest
    driven = rows[is_fast & is_steady & (rows[:, _ENGINE] > 0.0)]
    ratios = driven[:, _ENGINE] / driven[:, _OVER] if len(driven) else np.empty(0)
    higher_pa = np.abs(driven[:, _FIRST] - driven[:, _FIRST + 1])
    is_between = higher_pa <= CLOSED_PA  # unknown pressures say nothing
    bands = dict[int, BoolArray]()
    if are_named:
        for gear in np.unique(driven[:, _GEAR][driven[:, _GEAR] >= 1.0]).tolist():
            own = (driven[:, _GEAR] == gear) & ~is_between
            ratio = densest(ratios[own]) if np.count_nonzero(own) >= LEAST_SAMPLES else None
            if ratio is not None:
                bands[int(gear)] = own & _near(ratios, own, ratio.ratio)
    else:
        rest, middles = np.ones(len(ratios), np.bool_), dict[float, BoolArray]()
        while (ratio := densest(ratios[rest], 0.0)) is not None:
            if ratio.sample_count < max(LEAST_SAMPLES, LEAST_CLUSTER * len(ratios)):
                break
            middles[ratio.ratio] = rest & (np.abs(ratios / ratio.ratio - 1.0) < BAND)
            rest &= np.abs(ratios / ratio.ratio - 1.0) > APART_RATIO
        bands = {gear: middles[one] for gear, one in enumerate(sorted(middles, reverse=True), 1)}
    return {
        gear: LearnedGear(ratio=ratio, clutch=_clutch(driven[bands[gear]]))
        for gear, ratio in _at_constant_speed(driven, ratios, bands).items()
    }


def _near(ratios: FloatArray, own: BoolArray, middle: float) -> BoolArray:
    """Return which ratios are those of a gear: a band around its own ones that is as wide as they scatter."""
    width = BAND
    for _ in range(ROUNDS):
        inside = ratios[own & (np.abs(ratios / middle - 1.0) < width)]
        middle = float(np.median(inside))
        spread = 1.4826 * float(np.median(np.abs(inside / middle - 1.0)))
        width = min(max(BAND, OUTLYING * spread), MOST_BAND)
    return np.abs(ratios / middle - 1.0) < width


def _at_constant_speed(rows: FloatArray, ratios: FloatArray, bands: Mapping[int, BoolArray]) -> Mapping[int, GearRatio]:
    """Return the ratios of gears, freed of what both speeds are apart in time while the car gains speed.

    ln(ratio) = ln(ratio of the gear) + skew * d ln(speed)/dt, with a skew that is nearly one for all gears. The samples
    of a stretch share an error beside their own. Nothing is extrapolated: a gear that was driven only while the car
    gained speed is told at the least gain, as its speeds are recorded there, and what the skew makes of it is a part of
    the deviation.
    """
    if not bands:
        return {}
    told = [(gear, place) for gear, band in bands.items() for place in np.flatnonzero(band)]
    gears, places = (np.array(column) for column in zip(*told, strict=True))
    order = sorted(bands)
    is_of = (gears[:, None] == np.array(order)).astype(np.float64)
    growth_1_s, measured = rows[places, _GROWTH], np.log(ratios[places])
    design = np.column_stack([is_of, growth_1_s])
    stretches, is_settled = _stretches(rows[places, _TIME], gears)
    kept = is_settled
    for _ in range(2):
        found = np.linalg.lstsq(design[kept], measured[kept], rcond=None)[0]
        left = measured - design @ found
        kept = is_settled & (np.abs(left) <= OUTLYING * 1.4826 * np.median(np.abs(left[kept])) + 1e-9)
    scale = _deviations(left[kept], stretches[kept], len(order))
    design = design[kept] / scale[:, None]
    found = np.linalg.lstsq(design, measured[kept] / scale, rcond=None)[0]
    covariance = np.linalg.pinv(design.T @ design)
    result = {}
    for place, gear in enumerate(order):
        own = kept & (gears == gear)
        low_1_s, middle_1_s, high_1_s = np.quantile(growth_1_s[own], (0.1, 0.5, 0.9)) if own.any() else np.zeros(3)
        told_1_s = min(max(0.0, low_1_s), high_1_s)
        value = float(np.exp(found[place] + found[-1] * told_1_s))
        skewed = np.hypot(OWN_SKEW_S * middle_1_s, found[-1] * told_1_s)
        std = value * float(np.sqrt(covariance[place, place] + skewed**2 + SPEED_RATIO**2))
        result[gear] = GearRatio(value, std, int(np.count_nonzero(own)))
    return result


def _stretches(t_s: FloatArray, gears: Int64Array) -> tuple[Int64Array, BoolArray]:
    """Return which stretch each sample is of, and whether its clutch has taken over for good."""
    starts = np.concatenate(([True], (np.diff(t_s) > STRETCH_S) | (np.diff(gears) != 0)))
    stretches = np.cumsum(starts) - 1
    first_s, last_s = t_s[starts], t_s[np.append(starts[1:], True)]
    is_short = last_s - first_s < 2.0 * SETTLED_S
    return stretches, is_short[stretches] | (t_s - first_s[stretches] > SETTLED_S)


def _deviations(left: FloatArray, stretches: Int64Array, gear_count: int) -> FloatArray:
    """Return a deviation for each sample, so that a stretch weighs by its own error and by what its samples scatter.

    Too few stretches tell nothing of their own errors: then one is as far off as a sample.
    """
    _, of_stretch, lengths = np.unique(stretches, return_inverse=True, return_counts=True)
    within = float(np.var(left)) / lengths
    means = np.bincount(of_stretch, left) / lengths
    freedom = len(means) - gear_count
    known = float(means @ means) / freedom - float(within.mean()) if freedom >= gear_count else float(np.var(left))
    deviations: FloatArray = np.sqrt((max(0.0, known) + within) * lengths)[of_stretch] + LEAST_SCATTER
    return deviations


def _clutch(rows: FloatArray) -> int | None:
    """Return the clutch whose pressure is the higher one while a gear drives; None if that is not told."""
    higher = rows[:, _FIRST] - rows[:, _FIRST + 1]
    told = higher[np.abs(higher) > CLOSED_PA]  # unknown ones are not
    share = float(np.mean(told > 0.0)) if len(told) >= LEAST_SAMPLES else 0.5
    return 1 if share > SURE else 2 if share < 1.0 - SURE else None


def _held(rows: FloatArray, gears: Mapping[int, LearnedGear], clutch: int) -> LearnedValue | None:
    """Return the pressure that a clutch is held at in gear while the car stands; None if it is not."""
    own = [gear for gear, one in gears.items() if one.clutch == clutch]
    pressure = rows[:, _FIRST + clutch - 1]
    is_held = (rows[:, _OVER] < STANDING) & np.isin(rows[:, _GEAR], own) & (pressure > HELD_PA)
    if np.count_nonzero(is_held) < LEAST_SAMPLES:
        return None
    middle = float(np.median(pressure[is_held]))
    spread = 1.4826 * float(np.median(np.abs(pressure[is_held] - middle)))
    if spread > STEADY_PA:
        return None
    return LearnedValue(value=middle, std=float(np.hypot(HOLD_STD_PA, spread)), origin="held in gear at standstill")


def _unclosed(rows: FloatArray, gears: Mapping[int, LearnedGear]) -> dict[int, int]:
    """Return how many samples there are of gears that were driven, but tell no ratio."""
    numbers, counts = np.unique(rows[(rows[:, _OVER] > STANDING) & (rows[:, _GEAR] >= 1.0), _GEAR], return_counts=True)
    told = zip(numbers.astype(int).tolist(), counts.tolist(), strict=True)
    return {gear: count for gear, count in told if count >= LEAST_SAMPLES and gear not in gears}


def _held_run(rows: FloatArray, gears: Mapping[int, LearnedGear], source: Signal | None) -> str:
    """Return what a clutch carried, for people, if one gear alone was driven and it hardly ever slipped; else empty."""
    number, gear = next(iter(gears.items()), (0, None))
    if gear is None or gear.clutch is None or len(gears) > 1 or _unclosed(rows, gears):
        return ""
    driven = rows[(rows[:, _OVER] > LEAST_SPEED * rows[:, _OVER].max()) & (rows[:, _ENGINE] > 0.0)]
    is_closed = np.abs(driven[:, _ENGINE] / driven[:, _OVER] / gear.ratio.ratio - 1.0) < MOST_BAND
    closed = driven[is_closed & (driven[:, _FIRST + gear.clutch - 1] > HELD_PA)]
    if len(closed) < SURE * len(driven):
        return ""
    load, pressure_pa = closed[:, _LOAD], closed[:, _FIRST + gear.clutch - 1]
    ratios = np.nan_to_num(load) / pressure_pa
    hardest = int(np.abs(ratios - np.quantile(ratios, HARDEST)).argmin())
    carried = {
        None: "it did not slip",
        Signal.ENGINE_TORQUE: f"it carries at least {digits(load[hardest])} Nm",
        Signal.INJECTION_TIME: f"it carries at least what {digits(MS_PER_S * load[hardest])} ms of injection make",
    }[source]
    return (
        f"driven in gear {number} alone, as on a dynamometer: clutch {gear.clutch} was held, and {carried} "
        f"at {digits(bar_from_pa(pressure_pa[hardest]))} bar; no shift tells its friction"
    )


def _gains(
    phases: Sequence[SlipPhase], held: Mapping[int, LearnedValue], logs: Sequence[str]
) -> dict[int, LearnedValue]:
    """Return what slip phases of power upshifts tell of the gains of clutches; beside an unknown touch point, less.

    Both clutches are fitted together. Where not even the sign is held, there is no gain.
    """
    gains = dict[int, LearnedValue]()
    if len(phases) < LEAST_EVENTS:
        return gains
    touch_pa = float(np.mean([known.value for known in held.values()])) if held else None
    model = fitted(phases, touch_pa, logs)
    unit = model.scales.rate_rad_s2 / model.scales.pressure_pa
    wider = max(model.shift_widening, model.drive_widening or 0.0)
    for clutch in (1, 2):
        count, place = sum(phase.clutch == clutch for phase in phases), 1 + clutch
        value, std = float(model.parameters[place]), wider * float(np.sqrt(model.covariance[place, place]))
        std = float(np.hypot(std, GAIN_LAW_RATIO * value))
        if count >= LEAST_OF_CLUTCH and value > LEAST_CERTAIN * std:
            gains[clutch] = LearnedValue(value=unit * value, std=unit * std, origin=f"slip of {count} upshifts")
    return gains


class Survey:
    """The messages and signals of a log, with rates and ranges."""

    def __init__(self, codec: Codec, *, are_columns: bool = False) -> None:
        self._codec = codec
        self._are_columns = are_columns
        self._counts: Counter[int] = Counter()  # by slot, as all here
        self._signals: dict[int, dict[str, proposal.SignalStatistics]] = {}
        self._ends_ns: list[int] = []  # first and last
        self._ids: set[int] = set()
        self.frames = 0
        self.is_cut = False
        self.notes: tuple[str, ...] = ()  # what the reader of the log says of it

    @property
    def unknown(self) -> int:
        return self.frames - self._counts.total()

    def add(self, path: Path, is_stopped: Callable[[], bool], watch: Watch | None = None, columns: str = "") -> None:
        """Count all frames of a log; raises StoppedError."""
        with closing(read_log(path, is_stopped=is_stopped, watch=watch, columns=columns)) as reader:
            for batch in reader:
                if is_stopped():
                    raise StoppedError("stopped early: no profile is proposed from a part of a log")
                ends_ns = [*self._ends_ns, int(batch.t_ns.min()), int(batch.t_ns.max())]
                self._ends_ns = [min(ends_ns), max(ends_ns)]
                self.frames += len(batch)
                self._ids.update(np.unique(batch.can_id).tolist())
                for found in self._codec.decode(batch):
                    self._counts[found.slot] += len(found.rows)
                    table, seen = self._codec.tables[found.slot], self._signals.setdefault(found.slot, {})
                    for name, decoded in found.signals.items():
                        unit = table.definitions[name].unit or ""
                        fresh = proposal.SignalStatistics(
                            message=table.message.name, signal=name, unit=unit, is_column=self._are_columns
                        )
                        seen.setdefault(name, fresh).add(decoded)
        self.is_cut, self.notes = reader.counts.truncated, tuple(reader.counts.notes)

    @property
    def why_wrong(self) -> str:
        """Why the database is probably that of another bus; empty if it may be the right one."""
        known = int(np.count_nonzero(self._codec.slots_of([*self._ids]) != NOBODY))
        return why_wrong(known, len(self._ids), len(self._counts), len(self._codec.tables))

    def statistics(self) -> list[proposal.SignalStatistics]:
        return [one for _, seen in sorted(self._signals.items()) for _, one in sorted(seen.items())]

    def listing(self) -> Iterator[str]:
        """Yield a line for each message that came, with its rate, and one for each of its signals, with its range."""
        first_ns, last_ns = self._ends_ns or (0, 0)
        duration_s = (last_ns - first_ns) / NS_PER_S
        for slot, count in sorted(self._counts.items()):
            message = self._codec.tables[slot].message
            rate_hz = (count - 1) / duration_s if duration_s else 0.0
            name, unit = f"{message.name} ({message.frame_id:#x})", "frames"
            if self._are_columns:
                name, unit = message.name, "values"
            yield f"{name}: {count} {unit}, {rate_hz:.1f} Hz"
            for _, one in sorted(self._signals[slot].items()):
                span = f"{digits(one.lowest)} to {digits(one.highest)} {one.unit}".rstrip() if one.count else "no value"
                lost = {reason.replace("_", " "): count for reason, count in one.invalid._asdict().items() if count}
                called = "" if self._are_columns else f"{one.signal}: "
                yield f"  {called}{span}{''.join(f', {count} values {reason}' for reason, count in lost.items())}"


def proposed_profile(
    log: Path,
    dbc: Path | None = None,
    is_stopped: Callable[[], bool] = never,
    *,
    watch: Watch | None = None,
    columns: str = "",
) -> str:
    """Return a profile, as the text of a TOML file, whose comments say what signals the log holds."""
    named = () if dbc is not None else table_columns(log, is_stopped=is_stopped, columns=columns)
    are_columns, meant = bool(named), "its columns" if named else (dbc or DBC_PATH).name
    database = columns_database(named) if named else open_database(dbc)
    survey = Survey(Codec(database.messages, check_codes=True), are_columns=are_columns)
    survey.add(log, is_stopped, watch, columns)
    name, stem = (shown_name(log), "piped") if log == STANDARD_INPUT else (log.name, log.stem)
    best = proposal.candidates(survey.statistics())
    best, contests = judged(best, _tracks(log, database, best, columns) if log != STANDARD_INPUT else {})
    places = {signal: found[0].statistics.place for signal, found in best.items()}
    still = _still(log, database, best, columns)
    best = {signal: found for signal, found in best.items() if signal not in {one.signal for one in still}}
    over, ratios = _shown_ratios(log, database, best, columns, are_numbered=any(one.signal in GEARS for one in still))
    knows_gears = proposal.is_complete(ratios)
    reach = reach_in_words(best.keys(), knows_gears=knows_gears)
    asked = {"knows_gears": knows_gears, "has_converter": is_of_lockup(best.keys())}
    remarks = [
        f"Proposed for {name} and {meant} by names, units and values: check every line.",
        f"As it stands it reaches {reach}. {missing_for_next(best.keys(), **asked)}",
        "",
        *(["The log is cut off."] if survey.is_cut else []),
        *(f"The log: {note}." for note in survey.notes),
        f"{survey.frames} values." if are_columns else f"{survey.frames} frames, {survey.unknown} not in the database.",
        *([f"It is {why}."] if (why := survey.why_wrong) else []),
        *proposal.unfit_units(survey.statistics(), best),
        *proposal.questioned(best),
        *(contest.text for contest in contests),
        *(one.text(places[one.signal]) for one in still),
        *survey.listing(),
        "",
    ]
    signals = proposal.profile_text(legible(stem), best, [legible(remark) for remark in remarks])
    return signals + proposal.gears_text(over, ratios)


def _tracks(log: Path, database: Database, best: Best, columns: str) -> dict[tuple[Signal, int], Series]:
    """Return what the candidates for quantities were in a log, by quantity and rank; none without a contest."""
    if not needs_tracks(best):
        return {}
    pieces = dict[tuple[Signal, int], list[Series]]()
    for rank in range(MOST_CANDIDATES):
        sources = {signal: found[rank].source for signal, found in best.items() if len(found) > rank}
        if not sources:
            break
        decoder = Decoder(database, Profile(name="candidates", sources=sources))
        with closing(read_log(log, columns=columns)) as reader:
            for batch in decoder.whole(reader):
                for signal in sources.keys() & batch.columns.keys():
                    pieces.setdefault((signal, rank), []).append(thinned(batch.columns[signal]))
    return {key: joined(found) for key, found in pieces.items()}


def _still(log: Path, database: Database, best: Best, columns: str) -> tuple[StillSignal, ...]:
    """Return what a log shows to stand still where physics demands motion; nothing of what comes through a pipe."""
    liveness = Liveness.of(best.keys() & DEMANDS.keys() | best.keys() & COUPLED)
    if log == STANDARD_INPUT or not liveness.signals:
        return ()
    decoder = Decoder(database, Profile(name="proposed", sources=_sources(best)))
    with closing(read_log(log, columns=columns)) as reader:
        for batch in decoder.whole(reader):
            if (liveness := liveness.advanced(batch)).is_settled:
                break
    return liveness.still(LEAST_RECORDED)


def _sources(best: Best) -> dict[Signal, SignalSource]:
    return {signal: found[0].source for signal, found in best.items()}


def _shown_ratios(
    log: Path, database: Database, best: Best, columns: str, *, are_numbered: bool
) -> tuple[Signal, Mapping[int, proposal.GearRatio]]:
    """Return over which speed a log shows the ratios of which gears; none where they are not needed.

    Where no signal names gears they have ratios only if they ``are_numbered`` from the highest ratio on.
    """
    over = next((one for one in BEHIND if one in best), None)
    knows_slip = tier_of(best.keys()) is not None and best.keys() & {Signal.INPUT1_SPEED, Signal.INPUT_SPEED}
    if log == STANDARD_INPUT or over is None or knows_slip or is_of_lockup(best.keys()):
        return Signal.OUTPUT_SPEED, {}
    decoder, survey = Decoder(database, Profile(name="proposed", sources=_sources(best))), VehicleSurvey(over)
    with closing(read_log(log, columns=columns)) as reader:
        for one in decoder.whole(reader):
            survey.add(one)
    learned = survey.learned()
    return over, {gear: one.ratio for gear, one in learned.gears.items() if learned.are_named or are_numbered}
