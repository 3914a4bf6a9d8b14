"""How one channel has aged: a line that wanders, may have bent once, and has a temperature and a scale in it.

All of it is linear and normal, so each assumed bend has an exact answer; bends are weighted by how well each one
explains the results. Rates are then held against what is known of fluids: they age. Equations: docs/prognosis.md.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, Self

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.prognosis.assumptions import (
    BENT_LOG_STD,
    HORIZON_M,
    KNEE_PROBABILITY,
    LOAD_LOG_STD,
    ChannelPrior,
)
from diag_service.diagnosis.prognosis.channels import DISTANCE_M, Bins, Channel, Clock

KNEE_SHARES: Final = (0.1, 0.3, 0.5, 0.65, 0.75, 0.85, 0.9, 0.95)  # of the age, where a bend is looked for
LEAST_KNEE_BINS: Final = 8
RATE_STEPS: Final = np.linspace(-4.0, 4.0, 33)  # standard deviations about each bend's rate
LEAST_WEIGHT: Final = 5e-3  # of the largest: what is left out of a mixture


class Part(IntEnum):
    """What is asked of a fit: places in its vectors."""

    NOW = 0  # the channel today, without common errors
    RATE = 1  # per metre of the clock
    START = 2  # the channel when the fluid was first seen
    WARMTH = 3  # per kelvin
    SEEN_START = 4  # the start with its common errors: what two fluids of one vehicle share


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """What each assumed bend makes of a channel: (m, 5) means, (m, 5, 5) covariances, (m,) logarithms of evidence."""

    mean: FloatArray
    covariance: FloatArray
    log_evidence: FloatArray
    prior_rate_variance: FloatArray  # (m,) of the belief without sign


@dataclass(frozen=True, slots=True, kw_only=True)
class Mixture:
    """A channel today as a mixture of normal distributions, each at a fixed rate of ageing; shape (k,)."""

    weight: FloatArray  # sums to one
    rate_per_m: FloatArray  # of the clock, negative
    now: FloatArray
    now_variance: FloatArray
    start: FloatArray
    start_variance: FloatArray
    now_start_covariance: FloatArray
    wander: float  # of the rate, per metre of the clock
    random_per_m: float  # variance of random wear, likewise
    clock: Clock


def fit(channel: Channel, clock: int, now_m: float, prior: ChannelPrior, random_per_m: float) -> Fit:
    """Return what a channel says by the clock of this number, which stands at ``now_m``, if wear is that random."""
    bins, common_std, age_m = channel.bins, channel.common_std, channel.bins.ages_m[clock]
    shares = KNEE_SHARES if len(age_m) >= LEAST_KNEE_BINS else ()
    knees_m = np.array([np.inf, *(share * now_m for share in shares)])  # the first of them never
    reach_m = np.maximum(age_m - knees_m[:, None], 0.0)
    now_reach_m = np.maximum(now_m - knees_m, 0.0)
    knee = prior.knee_std_per_m**2
    warmth, warmth_variance = _warmth(bins, prior)
    seen = _shared(bins, age_m, prior, common_std, random_per_m, warmth_variance)
    seen = seen + knee * reach_m[:, :, None] * reach_m[:, None, :]
    cross = _cross(bins, age_m, prior, common_std, now_m, warmth_variance)[None, :, :].repeat(len(knees_m), axis=0)
    cross[:, Part.NOW] += random_per_m * age_m
    cross[:, Part.NOW] += knee * now_reach_m[:, None] * reach_m
    cross[:, Part.RATE] += knee * reach_m
    before = _before(prior, common_std, now_m, warmth_variance)[None, :, :].repeat(len(knees_m), axis=0)
    before[:, Part.NOW, Part.NOW] += knee * now_reach_m**2 + random_per_m * now_m
    before[:, Part.NOW, Part.RATE] += knee * now_reach_m
    before[:, Part.RATE, Part.NOW] += knee * now_reach_m
    before[:, Part.RATE, Part.RATE] += knee * (now_reach_m > 0.0)
    expected = np.array([prior.start, 0.0, prior.start, warmth, prior.start])
    surprise = bins.value - prior.start - warmth * bins.warmth_k
    residual = np.broadcast_to(surprise[:, None], (len(knees_m), len(age_m), 1))
    solved = np.linalg.solve(seen, np.concatenate((residual, cross.swapaxes(1, 2)), axis=2))
    _, log_determinant = np.linalg.slogdet(seen)
    explained = np.einsum("n,mn->m", surprise, solved[:, :, 0])
    return Fit(
        mean=expected + np.einsum("mpn,mn->mp", cross, solved[:, :, 0]),
        covariance=before - cross @ solved[:, :, 1:],
        log_evidence=_log_knee_prior(len(knees_m)) - 0.5 * (explained + log_determinant),
        prior_rate_variance=before[:, Part.RATE, Part.RATE],
    )


def _log_knee_prior(count: int) -> FloatArray:
    if count == 1:
        return np.zeros(1)
    shares = np.array(KNEE_SHARES)
    edges = np.concatenate(([0.0], 0.5 * (shares[1:] + shares[:-1]), [1.0]))  # a bend may come at any distance
    late = np.diff(edges**3)  # by wear so far, knees become likelier
    return np.asarray(np.log([1.0 - KNEE_PROBABILITY, *KNEE_PROBABILITY * late]), np.float64)


def _warmth(bins: Bins, prior: ChannelPrior) -> tuple[float, float]:
    """Return temperature coefficient and its variance, from what results that are close in age say of it."""
    before = prior.temperature_std_per_k**2
    share = before / (before + bins.warmth_variance)
    return share * bins.warmth_per_k, share * bins.warmth_variance


def _shared(
    bins: Bins,
    age_m: FloatArray,
    prior: ChannelPrior,
    common_std: float,
    random_per_m: float | FloatArray,
    warmth_variance: float,
) -> FloatArray:
    """Return the covariance of the bins, bends apart, shape (..., b, b); ages may have several clocks, (..., b)."""
    constant = prior.start_std**2 + common_std**2
    one, other = age_m[..., :, None], age_m[..., None, :]
    warmth = warmth_variance * np.outer(bins.warmth_k, bins.warmth_k)
    later, earlier = np.maximum(one, other), np.minimum(one, other)
    line = prior.rate_std_per_m**2 * one * other
    wander = prior.wander * earlier**2 * (3.0 * later - earlier) / 6.0 + random_per_m * earlier
    return np.asarray(constant + line + warmth + wander + np.diag(bins.variance + prior.floor_std**2))


def log_evidence(channel: Channel, prior: ChannelPrior, random_per_m: FloatArray) -> FloatArray:
    """Return the logarithm of the evidence for each clock and variance of random wear without bends, shape (c, v)."""
    bins = channel.bins
    warmth, warmth_variance = _warmth(bins, prior)
    seen = _shared(
        bins, bins.ages_m[:, None, :], prior, channel.common_std, random_per_m[:, None, None], warmth_variance
    )
    surprise = bins.value - prior.start - warmth * bins.warmth_k
    root = np.linalg.cholesky(seen)
    scaled = np.linalg.solve(root, np.broadcast_to(surprise[:, None], (*seen.shape[:-1], 1)))[..., 0]
    log_determinant = 2.0 * np.sum(np.log(np.diagonal(root, axis1=-2, axis2=-1)), axis=-1)
    return np.asarray(-0.5 * (np.sum(scaled**2, axis=-1) + log_determinant), np.float64)


def _cross(
    bins: Bins, age_m: FloatArray, prior: ChannelPrior, common_std: float, now_m: float, warmth_variance: float
) -> FloatArray:
    """Return the covariance of each part with the bins, bends apart, shape (5, b)."""
    start, rate = prior.start_std**2, prior.rate_std_per_m**2
    wander = prior.wander * age_m**2
    return np.array(
        [
            start + rate * now_m * age_m + wander * (3.0 * now_m - age_m) / 6.0,
            rate * age_m + wander / 2.0,
            np.full_like(age_m, start),
            warmth_variance * bins.warmth_k,
            np.full_like(age_m, start + common_std**2),
        ]
    )


def _before(prior: ChannelPrior, common_std: float, now_m: float, warmth_variance: float) -> FloatArray:
    """Return the covariance of the parts before any result, bends apart, shape (5, 5)."""
    start, rate = prior.start_std**2, prior.rate_std_per_m**2
    covariance = np.zeros((len(Part), len(Part)))
    covariance[np.ix_([Part.NOW, Part.START, Part.SEEN_START], [Part.NOW, Part.START, Part.SEEN_START])] = start
    covariance[Part.NOW, Part.NOW] += rate * now_m**2 + prior.wander * now_m**3 / 3.0
    covariance[Part.NOW, Part.RATE] = covariance[Part.RATE, Part.NOW] = rate * now_m + prior.wander * now_m**2 / 2.0
    covariance[Part.RATE, Part.RATE] = rate + prior.wander * now_m
    covariance[Part.WARMTH, Part.WARMTH] = warmth_variance
    covariance[Part.SEEN_START, Part.SEEN_START] += common_std**2
    return covariance


def weights(one: Fit) -> FloatArray:
    """Return the probability of each bend, without what is known of fluids, shape (m,)."""
    raw = np.exp(one.log_evidence - one.log_evidence.max())
    return np.asarray(raw / raw.sum())


def probability_falling(one: Fit) -> float:
    """Return the probability that the channel falls, by the results alone."""
    z = -one.mean[:, Part.RATE] / np.sqrt(one.covariance[:, Part.RATE, Part.RATE])
    return float(weights(one) @ normal_cdf(z))


def summary(one: Fit, part: Part) -> tuple[float, float]:
    """Return mean and deviation of a part over all bends."""
    weight, mean = weights(one), one.mean[:, part]
    centre = float(weight @ mean)
    return centre, float(np.sqrt(weight @ (one.covariance[:, part, part] + (mean - centre) ** 2)))


def fallen(one: Fit) -> tuple[float, float]:
    """Return mean and deviation of what the channel has lost since its start, over all bends."""
    weight, mean = weights(one), one.mean[:, Part.START] - one.mean[:, Part.NOW]
    covariance = one.covariance[:, [Part.START, Part.NOW]][:, :, [Part.START, Part.NOW]]
    variance = covariance[:, 0, 0] + covariance[:, 1, 1] - 2.0 * covariance[:, 0, 1]
    centre = float(weight @ mean)
    return centre, float(np.sqrt(weight @ (np.maximum(variance, 0.0) + (mean - centre) ** 2)))


def aged(one: Fit, prior: ChannelPrior, clock: Clock, random_per_m: float) -> tuple[Mixture, float]:
    """Return the channel at all rates at which a fluid may age, and the logarithm of the evidence for this clock.

    The belief without sign is taken out of each rate's probability and the one on ageing fluids put in.
    """
    mean, covariance = one.mean, one.covariance
    std = np.sqrt(covariance[:, Part.RATE, Part.RATE])
    rate = mean[:, Part.RATE, None] + std[:, None] * RATE_STEPS
    log_weight = one.log_evidence[:, None] - 0.5 * RATE_STEPS**2
    variance = one.prior_rate_variance[:, None]
    without_sign = -0.5 * (rate**2 / variance + np.log(variance))
    # What is usual says little of the rate after a bend: a knee makes it several times as large.
    log_std = np.array([prior.typical_log_std, *np.full(len(mean) - 1, np.hypot(prior.typical_log_std, BENT_LOG_STD))])
    log_weight = log_weight + _log_ageing(rate, prior, log_std[:, None]) - without_sign
    top = float(log_weight.max())
    if not np.isfinite(top):
        # Results say that friction rises: as slow an ageing as is known.
        slowest = np.full(len(mean), -prior.typical_rate_per_m * np.exp(-2.5 * prior.typical_log_std))
        farthest = -0.5 * float(RATE_STEPS[-1]) ** 2
        barely = _mixture(weights(one), slowest, mean, covariance, prior, clock, random_per_m)
        return barely, float(one.log_evidence.max()) + farthest
    weight = np.exp(log_weight - top)
    log_evidence = top + float(np.log(weight.sum()))
    bend, step = np.nonzero(weight > LEAST_WEIGHT * weight.max())
    chosen = weight[bend, step]
    gain = covariance[:, :, Part.RATE] / covariance[:, Part.RATE, Part.RATE, None]
    left = covariance - gain[:, :, None] * covariance[:, None, Part.RATE, :]
    moved = mean[bend] + gain[bend] * (rate[bend, step] - mean[bend, Part.RATE])[:, None]
    share = chosen / chosen.sum()
    return _mixture(share, rate[bend, step], moved, left[bend], prior, clock, random_per_m), log_evidence


def _mixture(
    weight: FloatArray,
    rate: FloatArray,
    mean: FloatArray,
    covariance: FloatArray,
    prior: ChannelPrior,
    clock: Clock,
    random_per_m: float,
) -> Mixture:
    return Mixture(
        weight=weight,
        rate_per_m=rate,
        now=mean[:, Part.NOW],
        now_variance=np.maximum(covariance[:, Part.NOW, Part.NOW], 0.0),
        start=mean[:, Part.START],
        start_variance=np.maximum(covariance[:, Part.START, Part.START], 0.0),
        now_start_covariance=covariance[:, Part.NOW, Part.START],
        wander=prior.wander,
        random_per_m=random_per_m,
        clock=clock,
    )


def _log_ageing(rate: FloatArray, prior: ChannelPrior, log_std: FloatArray) -> FloatArray:
    """Return the logarithm of the density of rates of fluids, up to a constant: losses are log-normal."""
    loss = np.where(rate < 0.0, -rate, 1.0)
    distance = (np.log(loss) - np.log(prior.typical_rate_per_m)) / log_std
    density = -0.5 * distance**2 - np.log(loss) - np.log(log_std)
    return np.asarray(np.where(rate < 0.0, density, -np.inf))


_LOADS: Final = np.array([-1.5, -0.5, 0.5, 1.5])  # standard deviations of the load
_LOAD_WEIGHTS: Final = np.array([0.159, 0.341, 0.341, 0.159])  # of the normal distribution beyond one, and below


@dataclass(frozen=True, slots=True, kw_only=True)
class UsualLife:
    """How old a fluid is and how long one lasts as a rule: the logarithm has Student's distribution, 3 degrees."""

    age_m: float
    median_m: float
    log_std: float


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

    def bent(self, bends: Mapping[float, float], usual: UsualLife | None = None) -> "Passage":
        """Return the same, widened by what is still to come: factors by which the rate may change, their chances."""
        return Passage(distance_m=self.distance_m, probability=self.bent_within(self.distance_m, bends, usual))

    def bent_within(
        self, distance_m: FloatArray, bends: Mapping[float, float], usual: UsualLife | None = None
    ) -> FloatArray:
        """Return the probability to pass the limit within each distance, if the load or the rate may still change.

        Either makes the clock of ageing run faster or slower, as if more or less were driven: a factor is that of the
        mean rate of what is left. A bend is likelier where it makes the whole life more usual.
        """
        factor = np.array([1.0, *bends])
        log_weight = np.log(np.maximum([1.0 - sum(bends.values()), *bends.values()], 1e-300))
        if usual is not None:
            life_m = np.maximum(usual.age_m + self.quantiles_m(np.array([0.5])) / factor, 1.0)
            log_density = -2.0 * np.log1p((np.log(life_m / usual.median_m) / usual.log_std) ** 2 / 3.0)
            log_weight += np.maximum(log_density - log_density[0], 0.0)
        weight = np.exp(log_weight - log_weight.max())
        driven_m = np.multiply.outer(distance_m, np.multiply.outer(factor, np.exp(_LOADS * LOAD_LOG_STD)))
        passed = np.interp(driven_m, self.distance_m, self.probability)
        return np.asarray(np.minimum(passed @ _LOAD_WEIGHTS @ (weight / weight.sum()), 1.0))


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


def normal_cdf(value: FloatArray) -> FloatArray:
    """Return the standard normal distribution function of each value."""
    from scipy.special import ndtr  # noqa: PLC0415 - it takes a while to load; only prognoses need it

    return np.asarray(ndtr(value))
