"""What a prognosis must beat, and by which scores; forecasts are distributions and stand as quantiles.

Beaten must be a fixed interval, a line through all results, a logistic index and the lives of a fleet. CRPS as in
Gneiting and Raftery (2007), alpha-lambda as in Saxena and others (2008).
"""

from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from clutch_results.prognosis import History
from studies.prognosis.lives import REFERENCE

PROBABILITIES: Final[FloatArray] = np.asarray(
    (np.arange(99) + 0.5) / 99.0, np.float64
)  # of the quantiles that a forecast stands as
COVERED: Final = 0.90
ALPHA: Final = 0.20
INTERVAL_KM: Final = 60_000.0  # what makers of wet dual-clutch transmissions commonly ask for
FARTHEST_KM: Final = 300_000.0
INDEX_KM: Final = 5_000.0
INDEX_MIDDLE: Final = 0.5  # of the margin
INDEX_WIDTH: Final = 0.25


def crps(quantiles: FloatArray, truth: FloatArray) -> FloatArray:
    """Return the continuous ranked probability score of each forecast, in the unit of the truth; of a number its error.

    Parameters
    ----------
    quantiles : (n, k) array
        Of each forecast, at evenly spaced probabilities.
    truth : (n,) array
    """
    ordered = np.sort(quantiles, axis=1)
    count = ordered.shape[1]
    rank = 2.0 * np.arange(1, count + 1) - count - 1.0
    error = np.mean(np.abs(ordered - truth[:, None]), axis=1)
    return np.asarray(error - ordered @ rank / count**2)


def is_covered(passed: FloatArray) -> FloatArray:
    """Return 1 where the truth lies in the central interval, else 0; ``passed``: the probability given to its side."""
    tail = 0.5 * (1.0 - COVERED)
    return np.where((passed >= tail) & (passed <= 1.0 - tail), 1.0, 0.0)


def is_near(median: FloatArray, truth: FloatArray) -> FloatArray:
    """Return 1 where the median is within ``ALPHA`` of what truly remains, else 0."""
    return np.where(np.abs(median - truth) <= ALPHA * truth, 1.0, 0.0)


def fixed_interval(age_km: float) -> FloatArray:
    """Return what remains of the maker's interval, a number without doubt, as quantiles [km]."""
    return np.full(len(PROBABILITIES), max(INTERVAL_KM - age_km, 0.0))


def fleet(age_km: float, lives_km: FloatArray) -> FloatArray:
    """Return what remained to those of a fleet whose fluid lasted longer than this one already has [km]."""
    left_km = lives_km[lives_km > age_km] - age_km
    if not len(left_km):
        return np.zeros(len(PROBABILITIES))
    return np.asarray(np.quantile(left_km, PROBABILITIES), np.float64)


def whole_line(history: History) -> FloatArray:
    """Return where a straight line through all results of the noted fluid leads, weighted by what they state [km]."""
    distance_km, margin = _margins(history)
    if len(margin) < 3:
        return _left(1.0, 0.0)
    own = history.fluid_number == history.fluid_number[-1]
    slope, now = np.polyfit(
        distance_km, margin, 1, w=1.0 / np.hypot(history.random_std_mu_c, history.random_std_mu_s)[own]
    )
    return _left(float(now), float(slope))


def logistic_index(history: History) -> FloatArray:
    """Return where the mean slope of a logistic index leads, later slopes weighing more [km].

    The index flattens a margin near new and near zero. Its means over some distance give slopes; the n-th weighs n.
    """
    distance_km, margin = _margins(history)
    place = ((distance_km - distance_km[0]) / INDEX_KM).astype(np.int64)
    index = np.asarray(_logistic(margin), np.float64)
    bins = [place == one for one in np.unique(place)]
    at_km = np.array([distance_km[own].mean() for own in bins])
    means = np.array([index[own].mean() for own in bins])
    if len(means) < 2:
        return _left(1.0, 0.0)
    slopes = np.diff(means) / np.maximum(np.diff(at_km), 1.0)
    rate_per_km = float(np.average(slopes, weights=np.arange(1, len(slopes) + 1)))
    return _left(float(means[-1]) - rate_per_km * float(at_km[-1]) - float(_logistic(np.zeros(1))[0]), rate_per_km)


def _margins(history: History) -> tuple[FloatArray, FloatArray]:
    """Return distances from today [km], negative, and margins with the noted fluid."""
    own = history.fluid_number == history.fluid_number[-1]
    distance_km = (history.odometer_m[own] - history.odometer_m[-1]) / 1000.0
    return distance_km, (history.mu_c[own] - history.mu_s[own]) / (REFERENCE.mu_c - REFERENCE.mu_s)


def _logistic(margin: FloatArray) -> FloatArray:
    return np.asarray(1.0 / (1.0 + np.exp(-(margin - INDEX_MIDDLE) / INDEX_WIDTH)), np.float64)


def _left(now: float, rate_per_km: float) -> FloatArray:
    """Return how far a line is from zero, as quantiles that are all alike."""
    left_km = -now / rate_per_km if rate_per_km < 0.0 else FARTHEST_KM
    return np.full(len(PROBABILITIES), min(max(left_km, 0.0), FARTHEST_KM))
