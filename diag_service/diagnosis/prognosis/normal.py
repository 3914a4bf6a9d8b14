"""The normal distribution for arrays; NumPy has none, and SciPy is not needed for anything else at run time."""

import numpy as np

from canlog.arrays import FloatArray

# Abramowitz and Stegun, Handbook of Mathematical Functions, 7.1.26; absolute error of erf below 1.5e-7.
_P = 0.3275911
_A = (0.254829592, -0.284496736, 1.421413741, -1.453152027, 1.061405429)
_BLOCK = 16_384  # values at a time: the system gives and takes larger arrays at every step, which costs twice the sum


def normal_cdf(value: FloatArray) -> FloatArray:
    """Return the standard normal distribution function of each value, to 1e-7."""
    flat = np.ravel(value)
    found = np.empty(flat.shape)
    for first in range(0, len(flat), _BLOCK):
        part = slice(first, first + _BLOCK)
        found[part] = _normal_cdf(flat[part])
    return found.reshape(np.shape(value))


def _normal_cdf(value: FloatArray) -> FloatArray:
    size = np.abs(value) / np.sqrt(2.0)
    t = 1.0 / (1.0 + _P * size)
    tail = (
        0.5 * np.exp(-(np.minimum(size, 30.0) ** 2)) * t * (_A[0] + t * (_A[1] + t * (_A[2] + t * (_A[3] + t * _A[4]))))
    )
    return np.asarray(np.where(value < 0.0, tail, 1.0 - tail))


def robust_noise_ratio(value: FloatArray, std: FloatArray) -> float:
    """Return how much larger the noise is than stated, at least 1; outliers and trends do not count."""
    if len(value) < 8:
        return 1.0
    steps = np.diff(value) / np.hypot(std[1:], std[:-1])
    return max(1.0, 1.4826 * float(np.median(np.abs(steps))))
