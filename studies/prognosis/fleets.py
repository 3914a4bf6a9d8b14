"""What a fleet teaches: types whose fluids last differently, learned from some vehicles, tried on others.

Vehicles of a type have all troubles of the single lives. New ones are foretold with and without what was learned.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Final, Protocol, TypeVar

import numpy as np
from rich.table import Table

from studies.prognosis.lives import DRIVEN_KM, ERRORS, life_of
from studies.prognosis.scores import PROBABILITIES, crps, is_covered
from studies.prognosis.truth import REFERENCE, Fleet
from canlog.arrays import FloatArray
from diag_service.diagnosis.prognosis import (
    Ageing,
    PeerGroup,
    Peers,
    Population,
    ageings,
    learn,
    prognose,
)

ResultT = TypeVar("ResultT")
TYPES: Final = {  # median life of fluid [km]; vehicles of one type scatter less than all vehicles do
    "short": 50_000.0,
    "usual": 80_000.0,
    "long": 120_000.0,
}
TYPE_LOG_STD: Final = 0.2
MARKS: Final = (0.1, 0.25, 0.5, 0.75)
M_PER_KM: Final = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """One prognosis with and without the fleet's knowledge; first without, then with."""

    mark: float
    life_km: float
    left_km: float
    passed: tuple[float, float]
    quantiles_km: tuple[FloatArray, FloatArray]


def fleet_of(name: str) -> Fleet:
    """Return the vehicles of a type."""
    return Fleet(usual_km=TYPES[name], life_log_std=TYPE_LOG_STD, stream=59 + list(TYPES).index(name))


def ageings_of_seed(seed: int, name: str, fleet: Fleet, until_km: float) -> list[Ageing]:
    """Return what a vehicle's fluids say of their kind by what was driven until an odometer."""
    life = life_of(seed, ERRORS, fleet)
    history = life.history.first(life.rows_until(until_km))
    kind = PeerGroup(vehicle_type=name, fluid="usual")
    return ageings(f"{name} {seed}", 1, history, REFERENCE, [kind, kind])


def told_of_seed(seed: int, fleet: Fleet, peers: Peers | None) -> list[Told]:
    """Return what is told of a vehicle at some shares of its fluid's life."""
    life = life_of(seed, ERRORS, fleet)
    told = []
    for mark in MARKS:
        odometer_km = life.begin_km + mark * life.life_km
        if odometer_km >= DRIVEN_KM:
            continue
        past = life.history.first(life.rows_until(odometer_km))
        left_km = life.change_km - odometer_km
        both = [prognose(1, past, REFERENCE, peers=one).change_fluid for one in (None, peers)]
        passages = [one.passage for one in both if one is not None]
        if len(passages) < len(both):
            continue
        told.append(
            Told(
                mark=mark,
                life_km=life.life_km,
                left_km=left_km,
                passed=(passages[0].within(left_km * M_PER_KM), passages[1].within(left_km * M_PER_KM)),
                quantiles_km=(
                    passages[0].quantiles_m(PROBABILITIES) / M_PER_KM,
                    passages[1].quantiles_m(PROBABILITIES) / M_PER_KM,
                ),
            )
        )
    return told


def told_table(told: Sequence[Told]) -> Table:
    """Return how much narrower intervals are with what the fleet teaches, at equal coverage."""
    table = Table(
        "age", "prognoses", "inside 90 %, without", "with", "half width, without", "with", "narrower",
        "CRPS, km, without", "with",
        title="New vehicles with and without what their fleet taught; widths where 90 % are inside",
    )  # fmt: skip
    for mark in MARKS:
        chosen = [one for one in told if one.mark == mark]
        cells, widths, scores = [], [], []
        for which in range(2):
            passed = np.array([one.passed[which] for one in chosen])
            quantiles = np.array([one.quantiles_km[which] for one in chosen])
            tail = float(np.quantile(np.minimum(passed, 1.0 - passed), 0.1))
            ends = np.quantile(quantiles, (tail, 1.0 - tail), axis=1)
            cells.append(f"{100.0 * float(np.mean(is_covered(passed))):.1f} %")
            widths.append(0.5 * float(np.median((ends[1] - ends[0]) / [one.life_km for one in chosen])))
            scores.append(float(np.mean(crps(quantiles, np.array([one.left_km for one in chosen])))))
        narrower = f"{100.0 * (1.0 - widths[1] / widths[0]):.0f} %"
        table.add_row(
            f"{100.0 * mark:.0f} %", str(len(chosen)), *cells, *(f"{one:.3f} of life" for one in widths), narrower,
            *(f"{one:,.0f}" for one in scores),
        )  # fmt: skip
    return table


def peers_table(population: Population) -> Table:
    """Return what was learned."""
    table = Table("type", "fluid", "lives", "channel", "start", "loss in 100,000 km", "scatter, log", title="Learned")
    for peers in population.peers:
        for name, usual in peers.channels.items():
            table.add_row(
                peers.kind.vehicle_type, peers.kind.fluid or "any", str(peers.life_count), name.value,
                f"{usual.start:.3f} ± {usual.start_std:.3f}", f"{usual.loss_per_m * 1.0e8:.3f}",
                f"{usual.loss_log_std:.2f}",
            )  # fmt: skip
    return table


def bends_table(population: Population) -> Table:
    """Return how often lives bend, as learned."""
    table = Table("type", "lives that ended", "bend", title="Lives that bend, as learned")
    for peers in population.peers:
        if peers.kind.fluid is None:
            table.add_row(peers.kind.vehicle_type, str(peers.bend_life_count), f"{100.0 * peers.bend_chance:.0f} %")
    return table


class Each(Protocol):
    """Does the same for many cases, maybe in several processes."""

    def __call__(self, work: Callable[[int], list[ResultT]], cases: range, /) -> list[list[ResultT]]:
        """Return the results of all cases in their order."""


def population_tables(first_seed: int, count: int, each: Each) -> list[Table]:
    """Learn from some vehicles of each type, try on others."""
    known, new = range(first_seed, first_seed + count), range(first_seed + count, first_seed + 2 * count)
    learned: list[Ageing] = []
    for name in TYPES:
        work = partial(ageings_of_seed, name=name, fleet=fleet_of(name), until_km=DRIVEN_KM)
        learned += chain.from_iterable(each(work, known))
    population = learn(learned)
    told: list[Told] = []
    for name in TYPES:
        tell = partial(told_of_seed, fleet=fleet_of(name), peers=population.of(name, "usual"))
        told += chain.from_iterable(each(tell, new))
    return [
        peers_table(population),
        bends_table(population),
        told_table(told),
    ]
