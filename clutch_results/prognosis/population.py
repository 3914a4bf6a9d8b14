"""What the clutches of a fleet have in common: how fast fluids of one kind age, how they bend, how far they differ.

Empirical Bayes: each life of a fluid says how fast it went, with its own doubt; the scatter beyond that doubt is that
of the population. Both are robust, so that a bad batch among many does not widen what is usual. How many lives bend is
found by expectation and maximization (Dempster, Laird, Rubin 1977).
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import msgspec
import numpy as np

from canlog.arrays import FloatArray, Int64Array
from clutch_results.prognosis.assumptions import KNEE_PROBABILITY, ChannelPrior
from clutch_results.prognosis.channels import ChannelName
from clutch_results.prognosis.history import History

SURE_STEP_STD: Final = 4.0  # of a step that many clutches make at once
LEAST_CLUTCHES: Final = 8  # that say what is common at one time
PERIOD_S: Final = 365.25 / 12.0 * 86_400.0  # a month


@dataclass(frozen=True, slots=True, kw_only=True)
class Common:
    """What all clutches of one type share from a month on, added up: natural logarithms of mu_C and mu_S."""

    first_period: int  # months since the epoch
    mu_c: tuple[float, ...]
    mu_s: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Monthly:
    """The means of one clutch with one fluid, month by month, shape (m,)."""

    period: Int64Array  # months since the epoch
    mu_c: FloatArray  # natural logarithms
    mu_s: FloatArray


def monthly(history: History) -> Iterator[Monthly]:
    """Yield the monthly means of each fluid that is known: a fill is no common step, even where a fleet has many."""
    period = (history.end_s / PERIOD_S).astype(np.int64)
    for number in np.unique(history.fluid_number):
        is_fluid = history.fluid_number == number
        periods, place = np.unique(period[is_fluid], return_inverse=True)
        count = np.bincount(place)
        means = (np.bincount(place, np.log(mu[is_fluid])) / count for mu in (history.mu_c, history.mu_s))
        yield Monthly(period=periods, **dict(zip(("mu_c", "mu_s"), means, strict=True)))


def common_of(clutches: Iterable[Monthly]) -> Common | None:
    """Return what the clutches of one type share; None: nothing."""
    means = list(clutches)
    if not means:
        return None
    first = min(int(monthly_means.period[0]) for monthly_means in means)
    period = np.concatenate([monthly_means.period for monthly_means in means]) - first
    clutch = np.repeat(np.arange(len(means)), [len(monthly_means.period) for monthly_means in means])
    courses = [
        common_course(period, clutch, np.concatenate([getattr(monthly_means, name) for monthly_means in means]))
        for name in ("mu_c", "mu_s")
    ]
    if not np.any(courses):
        return None
    mu_c, mu_s = (tuple(course.tolist()) for course in courses)
    return Common(first_period=first, mu_c=mu_c, mu_s=mu_s)


def without(history: History, common: Common | None) -> History:
    """Return a history without what all clutches of its type share; after the last month that is known it stays."""
    if common is None:
        return history
    month = (history.end_s / PERIOD_S).astype(np.int64) - common.first_period
    place = np.clip(month, 0, len(common.mu_c) - 1)
    courses = (history.mu_c, common.mu_c), (history.mu_s, common.mu_s)
    mu_c, mu_s = (np.asarray(mu * np.exp(-np.array(course)[place])) for mu, course in courses)
    return replace(history, mu_c=mu_c, mu_s=mu_s)


def common_course(period: Int64Array, clutch: Int64Array, value: FloatArray) -> FloatArray:
    """Return what all clutches share at each period: steps that most make at once, added up; shape (periods,).

    A software that reads torque otherwise, or a winter, moves all clutches of a type alike. What a clutch does by
    itself, and the fall that all have in common all the time, stay with it.

    Parameters
    ----------
    period, clutch, value : (n,) array
        Whole numbers from zero, and results of the clutch in the period.
    """
    periods, clutches = int(period.max()) + 1, int(clutch.max()) + 1
    place = clutch * periods + period
    count = np.bincount(place, minlength=periods * clutches).reshape(clutches, periods)
    total = np.bincount(place, value, minlength=periods * clutches).reshape(clutches, periods)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    course = np.zeros(periods)
    steps = np.diff(mean, axis=1)
    usual = _middle(steps[np.isfinite(steps)])[0]
    for column in range(periods - 1):
        steps_now = steps[np.isfinite(steps[:, column]), column]
        if len(steps_now) < LEAST_CLUTCHES:
            continue
        step, std = _middle(steps_now)
        if abs(step - usual) > SURE_STEP_STD * std:
            course[column + 1] = step - usual
    return np.asarray(np.cumsum(course))


def _middle(value: FloatArray) -> tuple[float, float]:
    if not len(value):
        return 0.0, 0.0
    middle = float(np.median(value))
    return middle, 1.2533 * 1.4826 * float(np.median(np.abs(value - middle))) / float(np.sqrt(len(value)))


LEAST_LIVES: Final = 8  # of a kind; fewer say nothing of their scatter
ASSUMED_LIVES: Final = 10.0  # that the assumed chance of a bend counts as
LEAST_SCATTER: Final = {"start": 0.005, "loss_log": 0.05}  # no population is believed to be all alike
MOST_LOSS_DOUBT: Final = 0.5  # of a loss: beyond that its logarithm is not normal
COURSE_LOG_STD: Final = 0.10  # the rate of one moment against the mean of its life so far: ageing is no straight line
HUBER_STD: Final = 2.0
_ROUNDS: Final = 50


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerGroup:
    """Which clutches are peers."""

    vehicle_type: str  # by the name of its calibration
    fluid: str | None  # its product; None: whatever it is


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """How one channel went over the life of one fluid so far."""

    start: float
    start_std: float
    loss_per_m: float  # mean since the fluid was new
    loss_std_per_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Ageing:
    """What the life of one fluid in one clutch says of its kind."""

    kind: PeerGroup
    courses: Mapping[ChannelName, Course]  # until the limit was passed, or so far
    lasted_m: float | None = None  # until the limit was passed; None: it was not
    bent_odds: float = 1.0  # that its wear clearly bent until then, over those before any result


@dataclass(frozen=True, slots=True, kw_only=True)
class Usual:
    """What is usual for one channel, and how far clutches scatter about it, their own doubts apart."""

    start: float
    start_std: float
    loss_per_m: float
    loss_log_std: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Peers:
    """What is usual for one kind of clutches."""

    kind: PeerGroup
    life_count: int
    channels: Mapping[ChannelName, Usual]
    bend_chance: float = KNEE_PROBABILITY  # that wear becomes clearly faster before the end of a life
    bend_life_count: int = 0  # lives that say so; 0: it is assumed
    version: int | None = None  # of the population

    def prior(self, name: ChannelName, before: ChannelPrior) -> ChannelPrior:
        """Return what to believe of a clutch of this kind with new fluid before its first result."""
        usual = self.channels.get(name)
        if usual is None:
            return before
        return replace(
            before,
            start=usual.start,
            start_std=usual.start_std,
            typical_rate_per_m=usual.loss_per_m,
            typical_log_std=min(float(np.hypot(usual.loss_log_std, COURSE_LOG_STD)), before.typical_log_std),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Population:
    """What was learned of a fleet."""

    life_count: int
    peers: tuple[Peers, ...]
    common: Mapping[str, Common] = field(default_factory=dict)  # what clutches of each type share, by its name
    version: int | None = None  # as it is kept; None: it is not

    def of(self, vehicle_type: str, fluid: str | None) -> Peers | None:
        """Return the peers of a clutch: those with the same fluid, or else all of its type; None: too few are known."""
        by_kind = {peers.kind: peers for peers in self.peers}
        any_fluid = by_kind.get(PeerGroup(vehicle_type=vehicle_type, fluid=None))
        peers = by_kind.get(PeerGroup(vehicle_type=vehicle_type, fluid=fluid), any_fluid)
        return None if peers is None else replace(peers, version=self.version)


def learn(lives: Iterable[Ageing]) -> Population:
    """Return what lives of fluids have in common, by type and fluid, and by type alone."""
    groups: dict[PeerGroup, list[Ageing]] = {}
    count = 0
    for life in lives:
        count += 1
        for kind in {life.kind, replace(life.kind, fluid=None)}:
            groups.setdefault(kind, []).append(life)
    order = sorted(groups, key=lambda kind: (kind.vehicle_type, kind.fluid or ""))
    types = {
        kind.vehicle_type: [life for life in groups[kind] if life.lasted_m is not None]
        for kind in order
        if kind.fluid is None
    }
    peers = (_peers(kind, groups[kind], types[kind.vehicle_type]) for kind in order)
    return Population(life_count=count, peers=tuple(one for one in peers if one.channels))


def _peers(kind: PeerGroup, lives: Sequence[Ageing], ended: Sequence[Ageing]) -> Peers:
    """Return what is usual for a kind; how often wear bends is told by all lives of its type that ended."""
    channels = {name: _usual([life.courses[name] for life in lives if name in life.courses]) for name in ChannelName}
    known = {name: usual for name, usual in channels.items() if usual is not None}
    if len(ended) < LEAST_LIVES:
        return Peers(kind=kind, life_count=len(lives), channels=known)
    odds, chance = np.array([life.bent_odds for life in ended]), KNEE_PROBABILITY
    for _ in range(_ROUNDS):
        bent_count = float(np.sum(chance * odds / (chance * odds + 1.0 - chance)))
        chance = (bent_count + ASSUMED_LIVES * KNEE_PROBABILITY) / (len(ended) + ASSUMED_LIVES)
    return Peers(kind=kind, life_count=len(lives), channels=known, bend_chance=chance, bend_life_count=len(ended))


def _usual(courses: Sequence[Course]) -> Usual | None:
    """Return what is usual for one channel; None if too few lives say so."""
    sure = [course for course in courses if 0.0 < course.loss_std_per_m < MOST_LOSS_DOUBT * course.loss_per_m]
    if len(sure) < LEAST_LIVES:
        return None
    start = np.array([course.start for course in sure])
    loss = np.array([course.loss_per_m for course in sure])
    doubt = np.array([course.loss_std_per_m for course in sure]) / loss
    centre, scatter = location_and_scatter(start, np.array([course.start_std for course in sure]))
    log_loss, loss_log_std = location_and_scatter(np.log(loss), doubt)
    return Usual(
        start=centre,
        start_std=max(scatter, LEAST_SCATTER["start"]),
        loss_per_m=float(np.exp(log_loss)),
        loss_log_std=max(loss_log_std, LEAST_SCATTER["loss_log"]),
    )


def location_and_scatter(value: FloatArray, std: FloatArray) -> tuple[float, float]:
    """Return the centre of values and their scatter beyond the doubt of each, robust against a few of another kind.

    The scatter is that with which half of all values are within the middle half of a normal distribution; a value far
    out counts less for the centre.
    """
    centre, low, high = float(np.median(value)), 0.0, float(np.ptp(value)) + 1e-12
    for _ in range(_ROUNDS):
        middle = 0.5 * (low + high)
        weight = 1.0 / (std**2 + middle**2 + 1e-24)
        distance = np.abs(value - centre) * np.sqrt(weight)
        centre = float(np.average(value, weights=weight * np.minimum(1.0, HUBER_STD / np.maximum(distance, 1e-12))))
        is_wider = float(np.median(np.abs(value - centre) * np.sqrt(weight))) > 0.6745
        low, high = (middle, high) if is_wider else (low, middle)
    return centre, 0.5 * (low + high)


SCHEMA: Final = "clutchdiag/population/v1"


def population_record(population: Population) -> dict[str, Any]:
    """Return a population as it is written, JSON-ready."""
    record = msgspec.to_builtins(population)
    peers = [{**one.pop("kind"), **one} for one in record["peers"]]
    common = [{"vehicle_type": name, **one} for name, one in record["common"].items()]
    for one in peers:
        del one["version"]  # that of the population
    return {"schema": SCHEMA, **record, "peers": peers, "common": common}


def population_from(record: object) -> Population:
    """Return the population that a record holds.

    Raises
    ------
    ValueError
        If it is none, or one of a newer program.
    """
    if not isinstance(record, Mapping) or record.get("schema") != SCHEMA:
        raise ValueError(f"no population of the schema {SCHEMA}")
    json.dumps(record, allow_nan=False)  # raises ValueError where a number is not finite
    try:
        peers = [{**one, "kind": one} for one in record["peers"]]
        common = {one["vehicle_type"]: one for one in record["common"]}
    except (KeyError, TypeError) as exc:
        raise ValueError(f"a population lacks something: {exc}") from exc
    for one in peers:
        if "bend_chance" not in one:  # earlier programs count bends otherwise
            one["bend_life_count"] = 0
    population = msgspec.convert({**record, "peers": peers, "common": common}, Population)
    for shared in population.common.values():
        if not shared.mu_c or len(shared.mu_c) != len(shared.mu_s):
            raise ValueError("common courses of mu_C and mu_S differ in length")
    return population
