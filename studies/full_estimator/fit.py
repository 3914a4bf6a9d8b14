"""Gauss-Newton on (mu_C, mu_S) of one clutch over all its windows, the slip of each window free within its error."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from studies.full_estimator.windows import Window
from canlog.arrays import FloatArray
from clutch_model.calibration import ClutchCalibration
from clutch_model.pack import FilmLaw, FrictionLaw, film_law, friction_law

MAX_ITERATIONS = 30
CONVERGED_STD = 0.02  # a step this small in standard deviations ends the iteration
FLOOR_RATIO = 0.002  # of friction: what the model itself may be wrong by
CHI_SQUARE_STD = 5.0  # a window whose chi-square is this far too large is not what the model describes
SLIP_OFFSET_STD_RAD_S = 0.03  # beyond the smoother's own: the last samples before a lock
SLIP_RATE_STD_RAD_S2 = 0.1
FRICTION_RANGE = (0.02, 0.5)
_NUDGES = (1e-5, 1e-5, 1e-3, 1e-3)  # of mu_C, mu_S, slip offset, slip rate


@dataclass(frozen=True, slots=True, kw_only=True)
class FullEstimate:
    """Friction of one clutch with its uncertainty."""

    mu_c: float
    mu_s: float
    std_mu_c: float  # no less than 0.2 % of the value
    std_mu_s: float
    random_std_mu_c: float  # from the noise of the sensors alone
    random_std_mu_s: float
    correlation: float  # of the random errors
    window_count: int
    rejected_count: int  # windows that the chi-square gate refused
    chi_square_ratio: float  # mean squared residual of the others, 1 expected


@dataclass(frozen=True, slots=True, kw_only=True)
class _Linearised:
    """One window about the present friction, its slip eliminated."""

    information: FloatArray  # (2, 2)
    gradient: FloatArray  # (2,)
    chi_square: float  # at the slip that fits best
    count: int

    @property
    def excess_std(self) -> float:
        """How far the chi-square is above what is expected, in standard deviations."""
        return (self.chi_square - self.count) / math.sqrt(2.0 * max(self.count, 1))


def fit(windows: Sequence[Window], believed: ClutchCalibration) -> FullEstimate | None:
    """Return the friction that explains the pressure readings best, or None where they do not determine it.

    Windows that the model does not describe go one by one, the worst first: a bad one makes good ones look bad.
    """
    law, friction = film_law(believed), friction_law(believed.friction)
    kept = list(windows)
    for iteration in range(MAX_ITERATIONS):
        linearised = [_linearise(window, friction, law) for window in kept]
        is_gated = False
        if kept and iteration > 0:
            excesses = [one.excess_std for one in linearised]
            worst = int(np.argmax(excesses))
            is_gated = excesses[worst] > CHI_SQUARE_STD
            if is_gated:
                del kept[worst], linearised[worst]
        information = sum((one.information for one in linearised), np.zeros((2, 2)))
        if not _is_regular(information):
            return None
        gradient = sum((one.gradient for one in linearised), np.zeros(2))
        step: FloatArray = np.linalg.solve(information, gradient).astype(np.float64)
        friction = _moved(friction, step)
        if iteration > 1 and not is_gated and float(step @ information @ step) < CONVERGED_STD**2:
            covariance: FloatArray = np.linalg.inv(information).astype(np.float64)
            estimate = _estimate(friction, covariance, linearised)
            return replace(estimate, rejected_count=len(windows) - len(kept))
    return None


def _moved(friction: FrictionLaw, step: FloatArray) -> FrictionLaw:
    low, high = FRICTION_RANGE
    mu_c, mu_s = (
        min(max(now + float(by), low), high) for now, by in zip((friction.mu_c, friction.mu_s), step, strict=True)
    )
    return friction._replace(mu_c=mu_c, mu_s=mu_s)


def _linearise(window: Window, friction: FrictionLaw, law: FilmLaw) -> _Linearised:
    plain_pa = window.piston_pa(friction, law)
    nudged = [
        window.piston_pa(friction._replace(mu_c=friction.mu_c + _NUDGES[0]), law),
        window.piston_pa(friction._replace(mu_s=friction.mu_s + _NUDGES[1]), law),
        window.piston_pa(friction, law, offset_rad_s=_NUDGES[2]),
        window.piston_pa(friction, law, rate_rad_s2=_NUDGES[3]),
    ]
    slopes = np.stack([(one - plain_pa) / nudge for one, nudge in zip(nudged, _NUDGES, strict=True)])
    is_known = np.isfinite(plain_pa) & np.isfinite(slopes).all(axis=0)
    slopes = slopes[:, is_known] / window.reading_std_pa
    residual = (window.reading_pa - plain_pa)[is_known] / window.reading_std_pa
    by_mu, by_slip = slopes[:2], slopes[2:]
    slip_std = math.hypot(window.slip_std_rad_s, SLIP_OFFSET_STD_RAD_S)
    prior = np.diag([slip_std**-2, SLIP_RATE_STD_RAD_S2**-2])
    weight = np.linalg.inv(by_slip @ by_slip.T + prior)
    through = by_mu @ by_slip.T @ weight
    pull = by_slip @ residual
    return _Linearised(
        information=by_mu @ by_mu.T - through @ by_slip @ by_mu.T,
        gradient=by_mu @ residual - through @ pull,
        chi_square=float(residual @ residual - pull @ weight @ pull),
        count=int(is_known.sum()),
    )


def _is_regular(information: FloatArray) -> bool:
    return bool(np.all(np.isfinite(information)) and np.linalg.cond(information) < 1e12)


def _estimate(friction: FrictionLaw, covariance: FloatArray, linearised: Sequence[_Linearised]) -> FullEstimate:
    random_c, random_s = (float(one) for one in np.sqrt(np.diag(covariance)))
    count = sum(one.count for one in linearised)
    return FullEstimate(
        mu_c=friction.mu_c,
        mu_s=friction.mu_s,
        std_mu_c=max(random_c, FLOOR_RATIO * friction.mu_c),
        std_mu_s=max(random_s, FLOOR_RATIO * friction.mu_s),
        random_std_mu_c=random_c,
        random_std_mu_s=random_s,
        correlation=float(covariance[0, 1]) / (random_c * random_s),
        window_count=len(linearised),
        rejected_count=0,
        chi_square_ratio=sum(one.chi_square for one in linearised) / max(count, 1),
    )
