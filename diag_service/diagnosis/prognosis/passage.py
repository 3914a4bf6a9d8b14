"""When a clutch passes a limit: probability over the distance still to drive, and what is read from it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.prognosis.assumptions import HORIZON_M, LOAD_LOG_STD
from diag_service.diagnosis.prognosis.clocks import DISTANCE_M
from diag_service.diagnosis.prognosis.normal import normal_cdf
from diag_service.diagnosis.prognosis.trend import Mixture

_BEND_EDGES: Final = np.array([0.0, 0.08, 0.2, 0.4, 0.65, 1.0])  # parts of what is left
_LOADS: Final = (-1.5, -0.5, 0.5, 1.5)  # standard deviations of the load
_LOAD_WEIGHTS: Final = (0.159, 0.341, 0.341, 0.159)  # of the normal distribution beyond one, and below


@dataclass(frozen=True, slots=True, kw_only=True)
class Passage:
    """Probability to have passed a limit after each distance from today; it never falls."""

    distance_m: FloatArray  # (d,) from 0 to the horizon
    probability: FloatArray  # (d,)

    def within(self, distance_m: float) -> float:
        """Return the probability to pass the limit within a distance."""
        return float(np.interp(distance_m, self.distance_m, self.probability))

    def quantile_m(self, probability: float) -> float | None:
        """Return the distance within which the limit is passed with this probability; None: beyond the horizon."""
        if probability > self.probability[-1]:
            return None
        return float(self.quantiles_m(np.array([probability]))[0])

    def quantiles_m(self, probabilities: FloatArray) -> FloatArray:
        """Return the same for several probabilities; what lies beyond the horizon counts as on it."""
        rising = self.probability + np.arange(len(self.probability)) * 1e-12  # a plateau has one end
        return np.asarray(np.interp(probabilities, rising, self.distance_m, left=0.0, right=HORIZON_M))

    def or_(self, other: Self) -> "Passage":
        """Return when the first of two limits is passed, as if they had nothing to do with each other.

        They have: what lowers one lowers the other. So the probability is rather too large than too small.
        """
        neither = (1.0 - self.probability) * (1.0 - other.probability)
        return Passage(distance_m=self.distance_m, probability=1.0 - neither)

    def bent(self, bends: Mapping[float, float]) -> "Passage":
        """Return the same, widened by what is still to come: factors by which the rate may change, their chances."""
        return Passage(distance_m=self.distance_m, probability=self.bent_within(self.distance_m, bends))

    def bent_within(self, distance_m: FloatArray, bends: Mapping[float, float]) -> FloatArray:
        """Return the probability to pass the limit within each distance, if the load or the rate may still change.

        Either makes the clock of ageing run faster or slower: as if more or less were driven. Where a bend comes is
        counted in what is left, so that a fluid near its end is as likely to bend before it as a newer one.
        """
        left_m = float(self.quantiles_m(np.array([0.5]))[0])
        total = np.zeros_like(distance_m)
        for load, load_weight in zip(_LOADS, _LOAD_WEIGHTS, strict=True):
            driven_m = distance_m * np.exp(load * LOAD_LOG_STD)
            for share, factor, weight in _scenarios(bends):
                aged_m = driven_m + (factor - 1.0) * np.maximum(driven_m - share * left_m, 0.0)
                total += load_weight * weight * np.interp(aged_m, self.distance_m, self.probability)
        return np.minimum(total, 1.0)


def passage(mixtures: Sequence[Mixture], limits: Sequence[tuple[float, float]]) -> Passage:
    """Return when a channel passes the first of some limits, if rates only wander.

    Parameters
    ----------
    mixtures :
        The channel today by each clock; all weights together sum to one.
    limits :
        Pairs: a number, and the share of the channel's own start that is added to it.
    """
    steady = np.max([np.sum([_steady(one, *limit) for one in mixtures], axis=0) for limit in limits], axis=0)
    return Passage(distance_m=DISTANCE_M, probability=np.maximum.accumulate(steady))


def _steady(mixture: Mixture, limit: float, start_share: float) -> FloatArray:
    """Return the probability to be below a limit after each distance, shape (d,)."""
    now = mixture.now - start_share * mixture.start
    variance = (
        mixture.now_variance
        - 2.0 * start_share * mixture.now_start_covariance
        + start_share**2 * mixture.start_variance
    )
    ahead_m = mixture.clock.ahead_m
    mean = now[:, None] + mixture.rate_per_m[:, None] * ahead_m
    spread = np.maximum(variance, 1e-12)[:, None] + mixture.wander * ahead_m**3 / 3.0 + mixture.random_per_m * ahead_m
    return np.asarray(mixture.weight @ normal_cdf((limit - mean) / np.sqrt(spread)))


def _scenarios(bends: Mapping[float, float]) -> tuple[tuple[float, float, float], ...]:
    """Return at which part of what is left the rate may change, by which factor, and how likely that is."""
    middles, widths = 0.5 * (_BEND_EDGES[1:] + _BEND_EDGES[:-1]), np.diff(_BEND_EDGES)
    later = [
        (float(share), factor, chance * float(width))
        for share, width in zip(middles, widths, strict=True)
        for factor, chance in bends.items()
    ]
    return (0.0, 1.0, 1.0 - sum(bends.values())), *later
