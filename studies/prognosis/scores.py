"""Scores of forecasts that are distributions: CRPS, coverage, alpha-lambda; forecasts stand as quantiles.

CRPS as in Gneiting and Raftery (2007), alpha-lambda as in Saxena and others (2008).
"""

from typing import Final

import numpy as np

from canlog.arrays import FloatArray

PROBABILITIES: Final[FloatArray] = np.asarray(
    (np.arange(99) + 0.5) / 99.0, np.float64
)  # of the quantiles that a forecast stands as
COVERED: Final = 0.90
ALPHA: Final = 0.20


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
