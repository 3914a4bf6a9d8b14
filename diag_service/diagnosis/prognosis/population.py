"""What the clutches of a fleet have in common: how fast fluids of one kind age, how far vehicles differ in that.

Empirical Bayes: each life of a fluid says how fast it went, with its own doubt; the scatter beyond that doubt is that
of the population. Both are robust, so that a bad batch among many does not widen what is usual.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.prognosis.assumptions import FUTURE_BENDS, ChannelPrior
from diag_service.diagnosis.prognosis.bends import Bends, Hindsight, bends_of
from diag_service.diagnosis.prognosis.channels import ChannelName
from diag_service.diagnosis.prognosis.common import Common

LEAST_LIVES: Final = 8  # of a kind; fewer say nothing of their scatter
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

    vehicle: str
    clutch: int
    kind: PeerGroup
    distance_m: float  # with this fluid
    is_present: bool  # the fluid that is in now
    courses: Mapping[ChannelName, Course]  # until the limit was passed, or so far
    lasted_m: float | None = None  # until the limit was passed; None: it was not


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
    bends: Bends = field(default_factory=lambda: FUTURE_BENDS)
    bend_life_count: int = 0  # lives that say how they bend; 0: it is assumed
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

    def name_of(self, vehicle_type: str, calibration_version: str) -> str:
        """Return by which name a type is known here: those of older programs have the version of its calibration."""
        known = {one.kind.vehicle_type for one in self.peers} | self.common.keys()
        return calibration_version if vehicle_type not in known and calibration_version in known else vehicle_type

    def of(self, vehicle_type: str, fluid: str | None) -> Peers | None:
        """Return the peers of a clutch: those with the same fluid, or else all of its type; None: too few are known."""
        known = {one.kind: one for one in self.peers}
        same = known.get(PeerGroup(vehicle_type=vehicle_type, fluid=fluid))
        found = known.get(PeerGroup(vehicle_type=vehicle_type, fluid=None)) if same is None else same
        return None if found is None else replace(found, version=self.version)


def with_bends(population: Population, told: Iterable[tuple[Ageing, Sequence[Hindsight]]]) -> Population:
    """Return a population that knows how lives of each type bend, by looks at past ones.

    Types of which fewer than `LEAST_LIVES` lives are looked at keep what is assumed.
    """
    groups: dict[str, list[Sequence[Hindsight]]] = {}
    for life, own in told:
        if own:
            groups.setdefault(life.kind.vehicle_type, []).append(own)
    known = {name: lives for name, lives in groups.items() if len(lives) >= LEAST_LIVES}
    bends = bends_of(known) if known else {}
    return replace(
        population,
        peers=tuple(
            replace(one, bends=bends[name], bend_life_count=len(known[name])) if name in bends else one
            for one in population.peers
            for name in (one.kind.vehicle_type,)
        ),
    )


def learn(lives: Iterable[Ageing]) -> Population:
    """Return what lives of fluids have in common, by type and fluid, and by type alone."""
    groups: dict[PeerGroup, list[Ageing]] = {}
    count = 0
    for life in lives:
        count += 1
        for kind in {life.kind, replace(life.kind, fluid=None)}:
            groups.setdefault(kind, []).append(life)
    order = sorted(groups, key=lambda kind: (kind.vehicle_type, kind.fluid or ""))
    found = (_peers(kind, groups[kind]) for kind in order)
    return Population(life_count=count, peers=tuple(one for one in found if one.channels))


def _peers(kind: PeerGroup, lives: Sequence[Ageing]) -> Peers:
    channels = {name: _usual([life.courses[name] for life in lives if name in life.courses]) for name in ChannelName}
    known = {name: usual for name, usual in channels.items() if usual is not None}
    return Peers(kind=kind, life_count=len(lives), channels=known)


def _usual(courses: Sequence[Course]) -> Usual | None:
    """Return what is usual for one channel; None if too few lives say so."""
    is_told = [0.0 < one.loss_std_per_m < MOST_LOSS_DOUBT * one.loss_per_m for one in courses]
    told = [course for course, is_sure in zip(courses, is_told, strict=True) if is_sure]
    if len(told) < LEAST_LIVES:
        return None
    start = np.array([one.start for one in told])
    loss = np.array([one.loss_per_m for one in told])
    doubt = np.array([one.loss_std_per_m for one in told]) / loss
    centre, scatter = location_and_scatter(start, np.array([one.start_std for one in told]))
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
