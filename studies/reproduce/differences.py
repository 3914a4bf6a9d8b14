"""Derivatives of signals without noise, and the filter whose rate comes nearest to them: how the paper tunes."""

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.friction.paper.driveline import TRACKING_DECADES, Rated, SteadyKalman, tracker
from diag_service.diagnosis.friction.paper.method import Differentiators

MIN_SAMPLE_COUNT = 5  # of the fourth-order stencils
_INNER = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
_FIRST = np.array([-25.0, 48.0, -36.0, 16.0, -3.0]) / 12.0
_SECOND = np.array([-3.0, -10.0, 18.0, -6.0, 1.0]) / 12.0


def central_difference(samples: FloatArray, period_s: float) -> Rated:
    """Return the samples as they are and their fourth-order derivative, eq. (10); one-sided at both ends.

    Raises
    ------
    ValueError
        With fewer than five samples.
    """
    if len(samples) < MIN_SAMPLE_COUNT:
        raise ValueError(f"a fourth-order derivative needs {MIN_SAMPLE_COUNT} samples, got {len(samples)}")
    rate = np.empty_like(samples)
    rate[2:-2] = np.correlate(samples, _INNER, mode="valid")
    head, tail = samples[:MIN_SAMPLE_COUNT], samples[: -MIN_SAMPLE_COUNT - 1 : -1]
    rate[0], rate[1] = _FIRST @ head, _SECOND @ head
    rate[-1], rate[-2] = -_FIRST @ tail, -_SECOND @ tail
    return Rated(value=samples, rate=rate / period_s)


def matched_filter(samples: FloatArray, ideal_rate: FloatArray, period_s: float) -> SteadyKalman:
    """Return the filter whose rate comes nearest (RMS) to the ideal one: how the paper chooses q.

    The ideal rate is that of the same signal without noise, by central differences.
    """
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - scipy takes a second

    def miss(tracking_decade: float) -> float:
        return float(np.mean((tracker(tracking_decade, period_s)(samples, period_s).rate - ideal_rate) ** 2))

    best = minimize_scalar(miss, bounds=TRACKING_DECADES, method="bounded", options={"xatol": 1e-3})
    return tracker(float(best.x), period_s)


NOISELESS = Differentiators(speed=central_difference, pressure=central_difference)
