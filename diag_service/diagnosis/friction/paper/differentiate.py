"""Speed and acceleration, pressure and its rate by a steady Kalman filter, docs/model.md eqs. (11) to (16).

SciPy solves for its gain, filterpy runs it. Both take a second to load, and only this method needs them.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from canlog.arrays import FloatArray

TRACKING_DECADES = (-14.0, 0.0)  # from asleep to believing every sample


@dataclass(frozen=True, slots=True, kw_only=True)
class Rated:
    """A signal and its derivative with respect to time, both (n,)."""

    value: FloatArray
    rate: FloatArray


Differentiator = Callable[[FloatArray, float], Rated]
"""Finds a signal and its rate, shape (n,) each, in even samples of it and their period [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SteadyKalman:
    """The estimator of eqs. (11) to (16) with a gain that has settled.

    ``x(n+1) = A*x(n) + L*(y(n) - C*x(n))``, x = (signal, rate): what it says at instant n knows the samples before n.
    """

    value_gain: float  # L of the signal [-]
    rate_gain_1_s: float  # L of its rate [1/s]

    def __call__(self, samples: FloatArray, period_s: float) -> Rated:
        """Return the filtered signal and rate; the filter starts at the first sample, at rest."""
        kalman = _kalman_filter()
        kalman.F = np.array([[1.0, period_s], [0.0, 1.0]])
        kalman.H = np.array([[1.0, 0.0]])
        kalman.K = np.linalg.solve(kalman.F, [[self.value_gain], [self.rate_gain_1_s]])  # L = F*K
        found = np.empty((len(samples), 2))
        for row, departure in zip(found, samples - samples[0], strict=True):
            row[:] = kalman.x[:, 0]
            kalman.update_steadystate(departure)
            kalman.predict_steadystate()
        return Rated(value=samples[0] + found[:, 0], rate=found[:, 1])

    def rate_noise_1_s(self, period_s: float) -> float:
        """Return the standard deviation of the rate per standard deviation of white noise in the samples [1/s].

        That of an alpha-beta tracker, which is what a steady filter of two states is.
        """
        beta = period_s * self.rate_gain_1_s
        alpha = self.value_gain - beta
        return math.sqrt(2.0 / (alpha * (4.0 - 2.0 * alpha - beta))) * beta / period_s


def _kalman_filter() -> Any:  # noqa: ANN401 - filterpy is untyped
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it loads matplotlib, whose own dependencies are deprecated
        from filterpy.kalman import KalmanFilter  # noqa: PLC0415 - as said above
    return KalmanFilter(dim_x=2, dim_z=1)


def steady_kalman_gain(period_s: float, rate_variance: float, sample_variance: float) -> tuple[float, float]:
    """Return the steady gain L of the paper's filter for signal and rate, eqs. (11) to (16).

    Parameters
    ----------
    period_s : float
        T; the process noise acts through G = (T^2/2, T).
    rate_variance, sample_variance : float
        q and r, in squared units of the rate's derivative and of the samples.
    """
    from scipy.linalg import solve_discrete_are  # noqa: PLC0415 - as said above

    # Scaled states (w, T*dw/dt) and unit measurement noise: the raw equation is too ill-conditioned.
    transition = np.array([[1.0, 1.0], [0.0, 1.0]])
    drive = np.array([0.5, 1.0]) * period_s**2
    process = np.outer(drive, drive) * rate_variance / sample_variance
    observed = np.array([[1.0, 0.0]])
    covariance = solve_discrete_are(transition.T, observed.T, process, np.eye(1))
    gain = transition @ covariance @ observed.T / (observed @ covariance @ observed.T + 1.0)
    return float(gain[0, 0]), float(gain[1, 0] / period_s)


def steady_kalman(period_s: float, rate_variance: float, sample_variance: float) -> SteadyKalman:
    """Return the filter of a process variance q and a sample variance r."""
    value_gain, rate_gain_1_s = steady_kalman_gain(period_s, rate_variance, sample_variance)
    return SteadyKalman(value_gain=value_gain, rate_gain_1_s=rate_gain_1_s)


def quiet_filter(period_s: float, sample_std: float, rate_std: float) -> SteadyKalman:
    """Return the fastest filter that turns white noise of ``sample_std`` into a rate no noisier than ``rate_std``.

    Raises
    ------
    ValueError
        If no filter of this period does.
    """
    from scipy.optimize import brentq  # noqa: PLC0415 - as said above

    def excess(tracking_decade: float) -> float:
        return tracker(tracking_decade, period_s).rate_noise_1_s(period_s) * sample_std / rate_std - 1.0

    return tracker(float(brentq(excess, *TRACKING_DECADES)), period_s)


def tracker(decade: float, period_s: float) -> SteadyKalman:
    """Return the filter whose ``q*T^4/r``, on which alone the gain depends, is 10 to the power ``decade``."""
    return steady_kalman(period_s, 10.0**decade / period_s**4, 1.0)
