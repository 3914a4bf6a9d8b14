"""Margin and level of one fluid over the distance, gathered into a few dozen means."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from clutch_model.calibration import FrictionCurve
from diag_service.diagnosis.prognosis.assumptions import REFERENCE_K
from diag_service.diagnosis.prognosis.clocks import Clock
from diag_service.diagnosis.prognosis.history import History
from diag_service.diagnosis.prognosis.normal import robust_noise_ratio

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
class Channel:
    """One quantity over the life of one fluid."""

    name: ChannelName
    bins: Bins
    common_std: float  # what all results have in common


def channels_of(
    history: History, first: int, stop: int, reference: FrictionCurve, clocks: tuple[Clock, ...]
) -> Iterator[Channel]:
    """Yield margin and level of the fluid in some rows, relative to those of new fluid."""
    place = _places(clocks[0].age_m)
    warmth_k = history.sump_temperature_k[first:stop] - REFERENCE_K
    ages_m = np.array([clock.age_m for clock in clocks])
    for name in ChannelName:
        value, std, common_std = _column(history, name, reference)
        yield Channel(
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
