"""What drives tell of a vehicle that nobody described: gears and their ratios, clutches, touch points, lags, rates.

Nothing is claimed that the drives do not show: a gear that was not driven with its clutch closed is absent, a lag needs
a commanded pressure. Every value has the standard deviation that its evidence allows, and says where it is from.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Series
from clutch_model.calibration import clutch_of_gear
from clutch_model.units import NS_PER_S
from diag_service.diagnosis.columns import ColumnBatch, GearRatios, Signal
from diag_service.diagnosis.prediction import LEAST_EVENTS, SlipPhase, fitted
from diag_service.mapping.proposal import LEAST_SAMPLES, LEAST_SPEED, GearRatio, densest

MOST_ROWS: Final = 400_000  # that are kept of all drives: beyond, every second one goes
STRETCH_S: Final = 1.0  # samples that are further apart are of another stretch, whose error is its own
LEAST_CLUSTER: Final = (
    0.01  # of all samples: so many lie in the band of a gear that is driven, where no signal names it
)
APART_RATIO: Final = 0.06  # neighbouring gears are further apart
CLOSED_PA: Final = 0.3e5  # the pressure of a closed clutch is higher by more than this
HELD_PA: Final = 0.3e5  # at standstill: what is less is an empty piston
STEADY_PA: Final = 0.15e5  # spread of a pressure that is held
STANDING: Final = 0.5  # rad/s or m/s
HOLD_STD_PA: Final = 1.0e4  # controllers hold a clutch that near to its touch point
TYPE_STD_PA: Final = 1.5e4  # by which the touch points of both clutches differ
MOST_LAG_S: Final = 0.12
LAG_STEP_S: Final = 0.002
MOVING_PA: Final = 0.5e5  # a command that moves by less tells no lag
SURE: Final = 0.9  # share of the samples
PRESSURES: Final = (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE)
COMMANDS: Final = (Signal.CLUTCH1_PRESSURE_COMMAND, Signal.CLUTCH2_PRESSURE_COMMAND)
GEARS: Final = (Signal.TARGET_GEAR, Signal.CURRENT_GEAR)
BAND: Final = 0.03  # of ratios around a gear's: a speed that grows moves them by up to this
GROWTH_S: Final = 0.3  # over which the gain of speed is a mean
OUTLYING: Final = 4.0
OWN_SKEW_S: Final = 0.007  # by which the skew of a gear differs from that of all: a driveline winds up
_TIME, _GEAR, _ENGINE, _OVER, _GROWTH, _FIRST = range(6)  # the columns that are kept; clutch pressures are the last


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
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
    touch_pa: Mapping[int, Found] = field(default_factory=dict)  # by clutch, as all that follows
    lag_s: Mapping[int, Found] = field(default_factory=dict)  # of a pressure behind its command
    gain_rad_s2_pa: Mapping[int, Found] = field(default_factory=dict)  # of the engine's speed: friction up to a scale
    rates_hz: Mapping[Signal, float] = field(default_factory=dict)  # at which signals came

    @property
    def ratios(self) -> GearRatios | None:
        """The ratios of all gears; None if one between them is missing."""
        if sorted(self.gears) != list(range(1, len(self.gears) + 1)) or not self.gears:
            return None
        return GearRatios(over=self.over, ratios=tuple(self.gears[one].ratio.ratio for one in sorted(self.gears)))

    def touch_point(self, clutch: int) -> Found | None:
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

    def learned(self, phases: Sequence[SlipPhase] = ()) -> LearnedVehicle:
        """Return what all that says; slip phases of power upshifts tell gains.

        They tell no touch point: friction that falls with slip moves where a line through them meets zero by 20 to
        60 kPa, more than a type is known to.
        """
        rows = np.concatenate([np.empty((0, _FIRST + len(PRESSURES))), *self.rows])
        gears = _gears_of(rows, are_named=self._has_gear)
        held = {clutch: found for clutch in (1, 2) if (found := _held(rows, gears, clutch)) is not None}
        gains = _gains(phases, held)
        lags = {clutch: np.array(found) for clutch, found in self._lags.items() if len(found) >= LEAST_EVENTS}
        return LearnedVehicle(
            over=self._over,
            gears=gears,
            are_named=self._has_gear,
            touch_pa=held,
            lag_s={clutch: _middle(found, "pressure behind its command") for clutch, found in lags.items()},
            gain_rad_s2_pa=gains,
            rates_hz={one: 1.0 / float(np.median(found)) for one, found in self._periods_s.items() if min(found) > 0.0},
        )


def _read(series: Series, other: Series) -> FloatArray:
    """Return a signal at the times of another one; unknown before and behind its own samples."""
    return np.interp(other.t_ns, series.t_ns, series.value, left=np.nan, right=np.nan)


def _growth_1_s(t_s: FloatArray, speed: FloatArray) -> FloatArray:
    """Return how fast the logarithm of a speed grows, as a mean over a short time."""
    after = np.minimum(np.searchsorted(t_s, t_s + 0.5 * GROWTH_S), len(t_s) - 1)
    before = np.maximum(np.searchsorted(t_s, t_s - 0.5 * GROWTH_S) - 1, 0)
    span_s = np.maximum(t_s[after] - t_s[before], 1e-3)
    growth: FloatArray = (speed[after] - speed[before]) / span_s / np.maximum(np.abs(speed), 1e-3)
    return growth


def _middle(found: FloatArray, origin: str) -> Found:
    spread = 1.4826 * float(np.median(np.abs(found - np.median(found))))
    least = 0.5 * LAG_STEP_S
    return Found(value=float(np.median(found)), std=max(least, spread / float(np.sqrt(len(found)))), origin=origin)


def _lag_s(pressure: Series, command: Series) -> list[float]:
    """Return by how much a pressure is behind its command, if that moves: where both differ least."""
    if float(np.ptp(command.value)) < MOVING_PA:
        return []
    lags_s = np.arange(0.0, MOST_LAG_S, LAG_STEP_S)
    t_s = (command.t_ns - command.t_ns[0]) / NS_PER_S
    own_s = (pressure.t_ns - command.t_ns[0]) / NS_PER_S
    costs = np.array([np.mean((np.interp(t_s + lag, own_s, pressure.value) - command.value) ** 2) for lag in lags_s])
    best = int(costs.argmin())
    return [float(lags_s[best])] if 0 < best < len(lags_s) - 1 else []


def _gears_of(rows: FloatArray, *, are_named: bool) -> Mapping[int, LearnedGear]:
    is_fast = rows[:, _OVER] > LEAST_SPEED * float(np.nanmax(rows[:, _OVER], initial=0.0))
    driven = rows[is_fast & (rows[:, _ENGINE] > 0.0)]
    ratios = driven[:, _ENGINE] / driven[:, _OVER] if len(driven) else np.empty(0)
    bands = dict[int, BoolArray]()
    if are_named:
        for gear in np.unique(driven[:, _GEAR][driven[:, _GEAR] >= 1.0]).tolist():
            own = driven[:, _GEAR] == gear
            ratio = densest(ratios[own]) if np.count_nonzero(own) >= LEAST_SAMPLES else None
            if ratio is not None:
                bands[int(gear)] = own & (np.abs(ratios / ratio.ratio - 1.0) < BAND)
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


def _at_constant_speed(rows: FloatArray, ratios: FloatArray, bands: Mapping[int, BoolArray]) -> Mapping[int, GearRatio]:
    """Return the ratios of gears, freed of what both speeds are apart in time while the car gains speed.

    ln(ratio) = ln(ratio of the gear) + skew * d ln(speed)/dt, with a skew that is nearly one for all gears. The samples
    of a stretch have one error.
    """
    if not bands:
        return {}
    told = [(gear, place) for gear, band in bands.items() for place in np.flatnonzero(band)]
    gears, places = (np.array(column) for column in zip(*told, strict=True))
    order = sorted(bands)
    is_of = (gears[:, None] == np.array(order)).astype(np.float64)
    growth_1_s, measured = rows[places, _GROWTH], np.log(ratios[places])
    design = np.column_stack([is_of, growth_1_s])
    kept = np.ones(len(measured), np.bool_)
    for _ in range(2):
        found = np.linalg.lstsq(design[kept], measured[kept], rcond=None)[0]
        left = measured - design @ found
        kept = np.abs(left) <= OUTLYING * 1.4826 * np.median(np.abs(left[kept])) + 1e-9
    starts = np.concatenate(([True], (np.diff(rows[places, _TIME]) > STRETCH_S) | (np.diff(gears) != 0)))
    stretches = np.cumsum(starts)
    lengths = np.bincount(stretches)[stretches]
    scaled = (design / np.sqrt(lengths)[:, None])[kept]
    counts = np.bincount(stretches[kept])
    means = np.bincount(stretches[kept], left[kept])[counts > 0] / counts[counts > 0]
    freedom = len(means) - len(order)  # too few stretches tell nothing of their own errors
    variance = float(means @ means) / freedom if freedom >= len(order) else float(np.var(left[kept]))
    covariance = variance * np.linalg.pinv(scaled.T @ scaled)
    result = {}
    for place, gear in enumerate(order):
        value, own = float(np.exp(found[place])), kept & (gears == gear)
        skewed = OWN_SKEW_S * abs(float(np.mean(growth_1_s[own]))) if own.any() else 0.0
        std = value * float(np.hypot(np.sqrt(covariance[place, place]), skewed))
        result[gear] = GearRatio(value, std, int(np.count_nonzero(own)))
    return result


def _clutch(rows: FloatArray) -> int | None:
    """Return the clutch whose pressure is the higher one while a gear drives; None if that is not told."""
    higher = rows[:, _FIRST] - rows[:, _FIRST + 1]
    told = higher[np.abs(higher) > CLOSED_PA]  # unknown ones are not
    share = float(np.mean(told > 0.0)) if len(told) >= LEAST_SAMPLES else 0.5
    return 1 if share > SURE else 2 if share < 1.0 - SURE else None


def _held(rows: FloatArray, gears: Mapping[int, LearnedGear], clutch: int) -> Found | None:
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
    return Found(value=middle, std=float(np.hypot(HOLD_STD_PA, spread)), origin="held in gear at standstill")


def _gains(phases: Sequence[SlipPhase], held: Mapping[int, Found]) -> dict[int, Found]:
    """Return what slip phases of power upshifts tell of the gains of clutches; beside an unknown touch point, less."""
    gains = dict[int, Found]()
    for clutch in (1, 2):
        own = [one for one in phases if one.clutch == clutch]
        if len(own) < LEAST_EVENTS:
            continue
        known = held.get(clutch)
        model = fitted(own, None if known is None else known.value)
        unit, place = model.scales.rate_rad_s2 / model.scales.pressure_pa, 1 + clutch
        value, std = abs(float(model.parameters[place])), float(np.sqrt(model.covariance[place, place]))
        gains[clutch] = Found(value=unit * value, std=unit * std, origin=f"slip of {len(own)} upshifts")
    return gains
