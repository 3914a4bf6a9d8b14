"""The normal distribution for arrays, and noise that outliers do not move."""

import numpy as np

from canlog.arrays import FloatArray


def normal_cdf(value: FloatArray) -> FloatArray:
    """Return the standard normal distribution function of each value."""
    from scipy.special import ndtr  # noqa: PLC0415 - it takes a while to load; only prognoses need it

    return np.asarray(ndtr(value))


def robust_noise_ratio(value: FloatArray, std: FloatArray) -> float:
    """Return how much larger the noise is than stated, at least 1; outliers and trends do not count."""
    if len(value) < 8:
        return 1.0
    steps = np.diff(value) / np.hypot(std[1:], std[:-1])
    return max(1.0, 1.4826 * float(np.median(np.abs(steps))))
