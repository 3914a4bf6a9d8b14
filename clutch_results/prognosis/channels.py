"""Margin and level of one fluid, gathered into a few dozen means over what it may age by.

By distance, the energy of slip, the heat of its oil, slower or faster as it gets old: each way to count is a clock. It
says how old the fluid was at each result, and how old it will be after each distance ahead, seasons included.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import product
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from clutch_model.calibration import FrictionCurve
from clutch_results.prognosis.assumptions import (
    ENERGY_PROBABILITY,
    HEATS_PER_K,
    HORIZON_M,
    REFERENCE_K,
    SHAPES,
    USUAL_LIFE_M,
)
from clutch_results.prognosis.history import History, robust_noise_ratio

# Denser near today, where it matters: 0, 12, 47, 105 km, ..., at last 3,700 km apart.
DISTANCE_M: Final = HORIZON_M * np.linspace(0.0, 1.0, 161) ** 2
LOAD_ROWS: Final = 60  # over which energy and heat of events are averaged
RECENT_ROWS: Final = 120  # that say how hard the clutch has to work now
YEAR_S: Final = 365.25 * 86_400.0
PACE_M: Final = 2.0e6  # ahead, over which today's pace is taken
STEADY: Final = 1.0  # shape of wear that neither slows nor hastens


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock:
    """One way to count the ageing of a fluid, in metres of usual driving."""

    age_m: FloatArray  # (n,) since the first row with this fluid
    ahead_m: FloatArray  # (d,) by which it advances over each of `DISTANCE_M` from today
    log_prior: float  # natural logarithm of its probability before any result
    shape: float = 1.0  # power of the work

    @property
    def pace(self) -> float:
        """How much faster it runs now than the odometer."""
        return float(np.interp(PACE_M, DISTANCE_M, self.ahead_m)) / PACE_M


def clocks_of(history: History, first: int, stop: int, *, is_new: bool) -> tuple[Clock, ...]:
    """Return the clocks of the fluid in some rows, distance alone first.

    Whether wear slows or hastens is asked of fluid only that was new when first seen: else its age is not known.
    """
    distance_m = history.odometer_m[first:stop] - history.odometer_m[first]
    shapes = {STEADY: SHAPES[STEADY], **SHAPES} if is_new else {STEADY: 1.0}
    return tuple(
        _shaped(distance_m, pace, ahead_m, shape, chance * shape_chance)
        for (pace, ahead_m, chance), (shape, shape_chance) in product(_works(history, first, stop), shapes.items())
    )


def _works(history: History, first: int, stop: int) -> Iterator[tuple[FloatArray, FloatArray, float]]:
    """Yield for each way to count work its pace at each row, its advance ahead, its probability."""
    energy_j = None if history.slip_energy_j is None else history.slip_energy_j[first:stop]
    has_energy = energy_j is not None and stop - first > LOAD_ROWS
    heats = HEATS_PER_K if stop - first > LOAD_ROWS else {0.0: 1.0}
    for heat_per_k, heat_chance in heats.items():
        heat = _smooth(
            np.exp(heat_per_k * (history.sump_temperature_k - np.mean(history.sump_temperature_k))), LOAD_ROWS
        )
        warm, ahead_m = heat[first:stop], _next_years_m(history, heat, stop)
        usual = float(np.mean(warm))
        chance = heat_chance * (1.0 - ENERGY_PROBABILITY if has_energy else 1.0)
        yield warm / usual, ahead_m / usual, chance
        if energy_j is not None and has_energy:
            load = _smooth(energy_j, LOAD_ROWS)
            load /= np.mean(load)
            recent = float(np.mean(load[-RECENT_ROWS:]))
            yield load * warm / usual, recent * ahead_m / usual, heat_chance * ENERGY_PROBABILITY


def _next_years_m(history: History, heat: FloatArray, stop: int) -> FloatArray:
    """Return the distance ahead weighted by heat, shape (d,): as in the last year, where so much is known."""
    end_s, odometer_m = history.end_s[:stop], history.odometer_m[:stop]
    first = int(np.searchsorted(end_s, end_s[-1] - YEAR_S))
    year_m = float(odometer_m[-1] - odometer_m[first])
    if end_s[-1] - end_s[0] < YEAR_S or stop - first < LOAD_ROWS or year_m <= 0.0:
        return np.asarray(DISTANCE_M * np.mean(heat[:stop]), np.float64)
    since_m = odometer_m[first:] - odometer_m[first]
    work_m = np.concatenate(([0.0], np.cumsum(np.diff(since_m) * heat[first + 1 : stop])))
    years = np.floor(DISTANCE_M / year_m)
    return np.asarray(years * work_m[-1] + np.interp(DISTANCE_M - years * year_m, since_m, work_m), np.float64)


def _shaped(distance_m: FloatArray, pace: FloatArray, ahead_m: FloatArray, shape: float, chance: float) -> Clock:
    work_m = np.concatenate(([0.0], np.cumsum(np.diff(distance_m) * pace[1:])))
    now = work_m[-1] / USUAL_LIFE_M
    return Clock(
        age_m=USUAL_LIFE_M * (work_m / USUAL_LIFE_M) ** shape,
        ahead_m=USUAL_LIFE_M * ((now + ahead_m / USUAL_LIFE_M) ** shape - now**shape),
        log_prior=float(np.log(chance)),
        shape=shape,
    )


def _smooth(value: FloatArray, width: int) -> FloatArray:
    """Return the means of the rows around each; at the ends of those that there are."""
    kernel = np.ones(width)
    return np.asarray(np.convolve(value, kernel, "same") / np.convolve(np.ones_like(value), kernel, "same"))


MOST_BINS: Final = 48
OUTLIER_STD: Final = 3.0
LEAST_SPREAD: Final = 1e-6  # squared kelvins over squared noise: less says nothing of a temperature coefficient


class ChannelName(StrEnum):
    """What is followed over the life of a fluid."""

    MARGIN = "margin"
    LEVEL = "level"


@dataclass(frozen=True, slots=True, kw_only=True)
class Bins:
    """Means of neighbouring results of one channel, shape (b,); clocks have shape (number of clocks, b)."""

    value: FloatArray
    variance: FloatArray  # random part only
    warmth_k: FloatArray  # oil temperature above the reference
    ages_m: FloatArray
    warmth_per_k: float  # slope over the oil temperature inside bins, of which their means know nothing
    warmth_variance: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TrendChannel:
    """One quantity over the life of one fluid."""

    name: ChannelName
    bins: Bins
    common_std: float  # what all results have in common


def channels_of(
    history: History, first: int, stop: int, reference: FrictionCurve, clocks: tuple[Clock, ...]
) -> Iterator[TrendChannel]:
    """Yield margin and level of the fluid in some rows, relative to those of new fluid."""
    place = _places(clocks[0].age_m)
    warmth_k = history.sump_temperature_k[first:stop] - REFERENCE_K
    ages_m = np.array([clock.age_m for clock in clocks])
    for name in ChannelName:
        value, std, common_std = _column(history, name, reference)
        yield TrendChannel(
            name=name,
            bins=_binned(value[first:stop], std[first:stop], warmth_k, ages_m, place),
            common_std=float(np.median(common_std[first:stop])),
        )


def _column(history: History, name: ChannelName, reference: FrictionCurve) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values, random and common deviations of a channel, each shape (n,)."""
    if name is ChannelName.LEVEL:
        new = reference.mu_c
        return history.mu_c / new, history.random_std_mu_c / new, history.common_std_mu_c / new
    new = reference.mu_c - reference.mu_s
    random = _std_of_difference(history.random_std_mu_c, history.random_std_mu_s, history.random_correlation)
    # A scale that both share does not move the margin's end, where they are equal.
    apart = _std_of_difference(
        history.common_std_mu_c / history.mu_c, history.common_std_mu_s / history.mu_s, history.common_correlation
    )
    return (history.mu_c - history.mu_s) / new, random / new, apart * history.mu_c / new


def _std_of_difference(one: FloatArray, other: FloatArray, correlation: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.maximum(one**2 + other**2 - 2.0 * correlation * one * other, 0.0)))


def _places(distance_m: FloatArray) -> Int64Array:
    """Return the bin of each row, of equal widths, those without rows left out."""
    span_m = max(float(distance_m[-1]), 1.0)
    raw = np.minimum((distance_m / span_m * MOST_BINS).astype(np.int64), MOST_BINS - 1)
    return np.asarray(np.unique(raw, return_inverse=True)[1], np.int64).reshape(-1)


def _binned(value: FloatArray, std: FloatArray, warmth_k: FloatArray, ages_m: FloatArray, place: Int64Array) -> Bins:
    """Return weighted means; a result far from the mean of its bin counts less."""
    wide = std * robust_noise_ratio(value, std)
    weight = wide**-2
    for _ in range(2):
        distance = np.abs(value - _means(value, weight, place)[place])
        weight = wide**-2 * np.minimum(1.0, OUTLIER_STD * wide / np.maximum(distance, 1e-12))
    mean, mean_warmth_k = _means(value, weight, place), _means(warmth_k, weight, place)
    apart_k = warmth_k - mean_warmth_k[place]
    spread = max(float(weight @ apart_k**2), LEAST_SPREAD)
    return Bins(
        value=mean,
        variance=np.asarray(1.0 / np.bincount(place, weight), np.float64),
        warmth_k=mean_warmth_k,
        ages_m=np.array([_means(age_m, weight, place) for age_m in ages_m]),
        warmth_per_k=float((weight * apart_k) @ (value - mean[place])) / spread,
        warmth_variance=1.0 / spread,
    )


def _means(value: FloatArray, weight: FloatArray, place: Int64Array) -> FloatArray:
    return np.asarray(np.bincount(place, weight * value) / np.bincount(place, weight), np.float64)
