"""How one channel has aged and how it may go on: courses of wear, weighted by what the results say of each.

A course is a clock, an amount of random wear and at most one bend, behind or ahead. Start, rates, errors and random
wear of each are linear and normal, so each has an exact answer. Rates and bends to come are summed over a grid. Ages
are counted in usual lives. Equations: docs/model.md, section "Prognosis".
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from canlog.arrays import FloatArray
from clutch_results.prognosis.assumptions import (
    BENT_FACTOR,
    BENT_LOG_STD,
    BENT_PROBABILITY,
    CLEAR_BEND,
    HAND_FACTOR,
    HAND_SHARE,
    HORIZON_M,
    KNEE_FACTORS,
    KNEE_SHARES,
    LOAD_LOG_STD,
    RANDOMNESS,
    RATE_BEFORE_STD,
    USUAL_LIFE_M,
    ChannelPrior,
)
from clutch_results.prognosis.channels import DISTANCE_M, Bins, Clock, TrendChannel

BENDS: Final = np.array([0.1, 0.3, 0.5, 0.65, 0.75, 0.85, 0.9, 0.95])  # of the age, where a bend is looked for
LEAST_BENT_BINS: Final = 8
LOSS_STEPS: Final = np.linspace(0.0, 1.0, 25)
FARTHEST_STD: Final = 3.5  # of a rate from its mean
MOST_LOG_RATIO: Final = 3.0  # of a loss over the usual one
LEAST_LOG_WEIGHT: Final = -6.0  # of a course against the best
COURSES: Final = 500  # of equal weight, that stand for all; the same one is taken more than once
NOW, START, RATE = range(3)  # places in the state of a course: the channel today and at first sight, and its rate
ALL: Final = slice(None)
CERTAIN_STD: Final = 9.0  # beyond it the normal distribution is 0 or 1 to all digits
_STUDENT: Final = 3.0  # degrees of freedom of the logarithm of a life
_LOG_STUDENT: Final = float(np.log(1.0883))  # its constant over that of the normal distribution


@dataclass(frozen=True, slots=True, kw_only=True)
class Value:
    """A number and its standard deviation."""

    mean: float
    std: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Future:
    """Courses that a channel may take from today, shape (k,)."""

    weight: FloatArray  # how likely each is; their sum is 1
    fall: FloatArray  # (k, d) over each of `DISTANCE_M`, a bend to come included
    fall_variance: FloatArray  # (k, d) of random wear and of the load to come
    now: FloatArray
    start: FloatArray
    now_variance: FloatArray
    start_variance: FloatArray
    now_start_covariance: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class AgedChannel:
    """One channel with one fluid. What is said of its past knows no sign: friction may seem to rise."""

    probability_falling: float  # since the start
    now: Value
    seen_start: Value  # with the errors that two fluids of one vehicle share
    fallen: Value  # since the start
    bent_odds: float  # that wear has clearly bent upwards, over those before any result
    rate_per_m: Value  # as fluids age
    future: Future


@dataclass(frozen=True, slots=True, kw_only=True)
class _Courses:
    """What the results say of each course, shape (clocks, amounts of random wear, bends behind, ...)."""

    log_weight: FloatArray
    unknown: FloatArray  # (..., 3) start as seen over that expected, rate before the bend, rate now
    unknown_covariance: FloatArray
    mean: FloatArray  # (..., 3) of the state
    covariance: FloatArray
    age: FloatArray  # (clocks,) today
    random: FloatArray  # (amounts,)


def aged(channel: TrendChannel, clocks: Sequence[Clock], prior: ChannelPrior, bend_chance: float) -> AgedChannel:
    """Return how a channel has aged and may age by each clock, the first of which is the plain distance.

    ``bend_chance`` is the probability that wear becomes clearly faster at some share of a life.
    """
    warmth = _warmth(channel.bins, prior)
    courses = _courses(channel, clocks, prior, warmth)
    future, rate_per_m = _future(courses, clocks, prior, bend_chance)
    # By distance, whatever clock explains it better.
    weight = np.exp(courses.log_weight[0] - courses.log_weight[0].max())
    weight /= weight.sum()
    mean, covariance = courses.mean[0], courses.covariance[0]
    unknown, unknown_covariance = courses.unknown[0], courses.unknown_covariance[0]
    fallen = mean[..., START] - mean[..., NOW]
    variance = covariance[..., NOW, NOW] + covariance[..., START, START] - 2.0 * covariance[..., NOW, START]
    variance = np.maximum(variance, 1e-12)
    is_bent = unknown[..., 2] < CLEAR_BEND * unknown[..., 1]
    is_bent[:, 0] = False
    bent = min(float(np.sum(weight * is_bent)), 0.999)
    return AgedChannel(
        probability_falling=float(np.sum(weight * normal_cdf(fallen / np.sqrt(variance)))),
        now=_value(weight, mean[..., NOW], covariance[..., NOW, NOW]),
        seen_start=_value(weight, prior.start + unknown[..., 0], unknown_covariance[..., 0, 0]),
        fallen=_value(weight, fallen, variance),
        bent_odds=bent / (1.0 - bent) * (1.0 - BENT_PROBABILITY) / BENT_PROBABILITY,
        rate_per_m=rate_per_m,
        future=future,
    )


def _value(weight: FloatArray, mean: FloatArray, variance: FloatArray | float) -> Value:
    centre = float(np.sum(weight * mean))
    spread = float(np.sum(weight * (variance + (mean - centre) ** 2)))
    return Value(mean=centre, std=spread**0.5)


def _warmth(bins: Bins, prior: ChannelPrior) -> Value:
    """Return the temperature coefficient, from what results that are close in age say of it."""
    before = prior.temperature_std_per_k**2
    share = before / (before + bins.warmth_variance)
    return Value(mean=share * bins.warmth_per_k, std=(share * bins.warmth_variance) ** 0.5)


def _courses(channel: TrendChannel, clocks: Sequence[Clock], prior: ChannelPrior, warmth: Value) -> _Courses:
    """Return the exact answer for each course: regression on start and two rates, with random wear in the errors."""
    bins, ages = channel.bins, channel.bins.ages_m / USUAL_LIFE_M
    age = np.array([clock.age_m[-1] for clock in clocks]) / USUAL_LIFE_M
    random = (prior.usual_wear * np.array(list(RANDOMNESS))) ** 2
    bends = BENDS if len(bins.value) >= LEAST_BENT_BINS else BENDS[:0]
    bend = np.multiply.outer(age, [0.0, *bends])  # the first of them none
    before = np.minimum(ages[:, None, :], bend[:, :, None])
    surprise = bins.value - prior.start - warmth.mean * bins.warmth_k
    level = np.broadcast_to([surprise, np.ones_like(surprise)], (len(clocks), 2, len(surprise)))
    warm = np.broadcast_to(warmth.std * bins.warmth_k, (len(clocks), 1, len(surprise)))
    given = np.concatenate((level, before, ages[:, None] - before, warm), axis=1)
    gram, log_determinant = gram_matrices(given, ages, bins.variance + prior.floor_std**2, random)
    walk = random[:, None] * gram[:, :, 2 + bend.shape[1]]  # of random wear today with that at each mean
    place = np.array([[1, 2 + column, 2 + bend.shape[1] + column] for column in range(bend.shape[1])])

    usual = prior.typical_rate_per_m * USUAL_LIFE_M
    start_variance, common_variance = prior.start_std**2, channel.common_std**2
    expected = np.array([0.0, -usual, 0.0])
    stds = [np.hypot(prior.start_std, channel.common_std), RATE_BEFORE_STD * usual, prior.rate_std_per_m * USUAL_LIFE_M]
    precision = np.array(stds) ** -2.0
    known = gram[:, :, place[:, :, None], place[:, None, :]] + np.diag(precision)
    unknown_covariance = np.asarray(np.linalg.inv(known), np.float64)
    pull = gram[:, :, place, 0] + precision * expected
    unknown = np.einsum("cvmij,cvmj->cvmi", unknown_covariance, pull)
    misfit = gram[:, :, 0, 0] + log_determinant
    explained = np.einsum("cvmi,cvmi->cvm", pull, unknown) + np.linalg.slogdet(unknown_covariance)[1]
    chances = np.add.outer([clock.log_prior for clock in clocks], np.log(list(RANDOMNESS.values())))

    # From the unknowns to the state: a part of the start as seen is an error, and random wear is in what is now.
    true_share = start_variance / (start_variance + common_variance)
    to_now = np.stack((np.full_like(bend, true_share), bend, age[:, None] - bend), axis=-1)[:, None]
    turn = np.zeros((*unknown.shape, 3))
    turn[..., NOW, :] = to_now - walk[:, :, place]
    turn[..., START, 0] = true_share
    turn[..., RATE, 2] = 1.0
    mean = np.einsum("cvmij,cvmj->cvmi", turn, unknown)
    mean[..., : START + 1] += prior.start
    mean[..., NOW] += walk[:, :, 0, None]
    state = turn @ unknown_covariance @ turn.swapaxes(-1, -2)
    state[..., : START + 1, : START + 1] += true_share * common_variance
    state[..., NOW, NOW] += (np.multiply.outer(age, random) - random * walk[:, :, 2 + bend.shape[1]])[:, :, None]
    return _Courses(
        log_weight=0.5 * (explained - misfit[:, :, None]) + chances[:, :, None] + _log_bent(bends),
        unknown=unknown,
        unknown_covariance=unknown_covariance,
        mean=mean,
        covariance=state,
        age=age,
        random=random,
    )


def gram_matrices(
    columns: FloatArray, ages: FloatArray, variance: FloatArray, random: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return products of columns by the inverse covariance of their rows, and the logarithm of its determinant.

    Random wear is a Brownian motion over the age: the innovations of its Kalman filter do not correlate.

    Parameters
    ----------
    columns : (c, k, b) array
        By clock. The last column is a deviation that all rows have in common.
    ages : (c, b) array
        Of the rows, by clock; they do not fall.
    variance : (b,) array
        Of the noise of each row.
    random : (v,) array
        Variances of random wear over an age of 1.

    Returns
    -------
    (c, v, k, k) and (c, v) array
    """
    steps, wear = np.diff(ages, prepend=0.0), np.zeros((len(ages), len(random)))
    white = np.empty((*wear.shape, *columns.shape[1:]))
    log_determinant, expected = np.zeros_like(wear), np.zeros(white.shape[:-1])
    for row, noise in enumerate(variance):
        wear = wear + np.multiply.outer(steps[:, row], random)
        total = wear + noise
        innovation = columns[:, None, :, row] - expected
        white[..., row] = innovation / np.sqrt(total)[..., None]
        expected += (wear / total)[..., None] * innovation
        log_determinant += np.log(total)
        wear = wear * noise / total
    gram = white @ white.swapaxes(-1, -2)
    common, own = gram[..., -1], 1.0 + gram[..., -1, -1]
    gram = gram - common[..., None] * (common / own[..., None])[..., None, :]  # Sherman and Morrison
    return gram, log_determinant + np.log(own)


def _log_bent(bends: FloatArray) -> FloatArray:
    if not len(bends):
        return np.zeros(1)
    edges = np.concatenate(([0.0], 0.5 * (bends[1:] + bends[:-1]), [1.0]))  # a bend may come at any distance
    late = np.diff(edges**3)  # by wear so far, bends become likelier
    return np.asarray(np.log([1.0 - BENT_PROBABILITY, *BENT_PROBABILITY * late]), np.float64)


def _future(
    courses: _Courses, clocks: Sequence[Clock], prior: ChannelPrior, bend_chance: float
) -> tuple[Future, Value]:
    """Return the courses to come and the rate today: losses only, none unheard of.

    The belief without sign is taken out of each rate's probability, that on ageing fluids and whole lives put in.
    """
    likely = np.nonzero(courses.log_weight > courses.log_weight.max() + LEAST_LOG_WEIGHT)
    clock, amount, bend = likely
    mean, covariance = courses.mean[likely], courses.covariance[likely]
    usual, any_std = prior.typical_rate_per_m * USUAL_LIFE_M, prior.rate_std_per_m * USUAL_LIFE_M
    middle, variance = -mean[:, RATE], covariance[:, RATE, RATE]
    bounds = usual * np.exp([-MOST_LOG_RATIO, MOST_LOG_RATIO])
    reach = FARTHEST_STD * np.sqrt(variance)
    low, high = (np.log(np.clip(middle + distance, *bounds)) for distance in (-reach, reach))
    width = np.maximum(high - low, 1e-6)[:, None]
    loss = np.exp(low[:, None] + width * LOSS_STEPS)
    of_results = -0.5 * (loss - middle[:, None]) ** 2 / variance[:, None] + 0.5 * (loss / any_std) ** 2
    log_weight = courses.log_weight[likely][:, None] + of_results + np.log(width / np.sqrt(variance)[:, None])

    # What may come: nothing, a bend at hand, or a knee at some share of the life; after one bend no knee.
    factors = np.array([1.0, HAND_FACTOR, *np.repeat(list(KNEE_FACTORS), len(KNEE_SHARES))])
    shares = np.array([1.0, 0.0, *np.tile(list(KNEE_SHARES), len(KNEE_FACTORS))])
    knees = bend_chance * np.outer(list(KNEE_FACTORS.values()), list(KNEE_SHARES.values())).ravel()
    at_hand = HAND_SHARE * bend_chance
    log_chance = np.log([1.0 - bend_chance - at_hand, at_hand, *knees])
    row, way = np.nonzero((bend == 0)[:, None] | (np.arange(len(factors)) < 2))
    is_knee, is_bent, factor, share = way >= 2, bend[row] > 0, factors[way, None], shares[way, None]
    lost = loss[row]
    left = np.maximum(mean[row, None, NOW] - prior.start + prior.fall, 0.0) / lost
    life = prior.fall / lost / np.where(is_knee[:, None], 1.0 + (factor - 1.0) * (1.0 - share), 1.0)
    knee = np.maximum(share * life - courses.age[clock[row], None], 0.0)
    shape = np.array([one.shape for one in clocks])[clock[row], None]
    log_ratio = np.log(life * usual / prior.fall) / shape / prior.typical_log_std
    density = -0.5 * (_STUDENT + 1.0) * np.log1p(log_ratio**2 / _STUDENT)
    density -= np.log(prior.typical_log_std * shape) + _LOG_STUDENT
    was = np.log(np.maximum(-courses.unknown[likely][row[is_bent], 1], 0.2 * usual) * BENT_FACTOR)[:, None]
    density[is_bent] = -0.5 * ((np.log(lost[is_bent]) - was) / BENT_LOG_STD) ** 2 - np.log(BENT_LOG_STD)
    density[is_knee[:, None] & (knee <= 0.0)] = -np.inf
    every = log_weight[row] + density + log_chance[way, None]

    # Evenly by what is left, so that few courses stand for all.
    near = np.where(factor > 1.0, np.minimum(left, knee), left)
    order = np.argsort(near + (left - near) / factor, axis=None)
    cumulative = np.cumsum(np.exp(every - every.max()).ravel()[order])
    evenly = order[np.searchsorted(cumulative, cumulative[-1] * (np.arange(COURSES) + 0.5) / COURSES)]
    picked, times = np.unique(evenly, return_counts=True)  # a fifth to two thirds of them differ
    pair, step = np.unravel_index(picked, every.shape)
    row, way, own = row[pair], way[pair], lost[pair, step]
    gain = covariance[:, :, RATE] / variance[:, None]
    known = covariance - gain[:, :, None] * covariance[:, None, RATE]
    moved = mean[row] + gain[row] * (middle[row] - own)[:, None]
    advance = (np.array([one.ahead_m for one in clocks]) / USUAL_LIFE_M)[clock[row]]
    to_bend = np.where(way > 0, knee[pair, step], np.inf)[:, None]
    per_m = -own * np.array([one.pace for one in clocks])[clock[row]] / USUAL_LIFE_M
    ahead = advance + (factors[way] - 1.0)[:, None] * np.maximum(advance - to_bend, 0.0)
    fall = own[:, None] * ahead
    future = Future(
        weight=times / COURSES,
        fall=fall,
        fall_variance=courses.random[amount[row], None] * ahead + (LOAD_LOG_STD * fall) ** 2,
        now=moved[:, NOW],
        start=moved[:, START],
        now_variance=known[row, NOW, NOW],
        start_variance=known[row, START, START],
        now_start_covariance=known[row, NOW, START],
    )
    return future, _value(future.weight, per_m, 0.0)


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


def passage(future: Future, limits: Sequence[tuple[float, float]], part: slice = ALL) -> Passage:
    """Return when a channel passes the first of some limits: a number, and the share of its own start added to it.

    A ``part`` of `DISTANCE_M` is looked at, by default all.
    """
    fall, to_come = future.fall[:, part], future.fall_variance[:, part]
    passed = []
    for limit, share in limits:
        variance = future.now_variance - 2.0 * share * future.now_start_covariance + share**2 * future.start_variance
        beyond = (limit + share * future.start - future.now)[:, None] + fall
        passed.append(future.weight @ normal_cdf(beyond / np.sqrt(np.maximum(variance, 1e-12)[:, None] + to_come)))
    return Passage(distance_m=DISTANCE_M[part], probability=np.maximum.accumulate(np.max(passed, axis=0)))


def normal_cdf(value: FloatArray) -> FloatArray:
    """Return the standard normal distribution function of each value."""
    from scipy.special import ndtr  # noqa: PLC0415 - it takes a while to load; only prognoses need it

    share, is_open = np.where(value > 0.0, 1.0, 0.0), np.abs(value) < CERTAIN_STD
    share[is_open] = ndtr(value[is_open])  # dear, and most values lie far outside
    return share
