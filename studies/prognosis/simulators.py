"""Prognoses of lives by three sets of laws, held against the better of a straight line and a constant life."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from rich.table import Table

from studies.prognosis.baselines import FARTHEST_KM, whole_line
from studies.prognosis.evaluation import M_PER_KM, early_looks, passage_at
from studies.prognosis.lives import DRIVEN_KM, Life, life_of
from studies.prognosis.scores import PROBABILITIES, crps, is_covered
from studies.prognosis.truth import KM_PER_YEAR
from studies.prognosis.wear import USUAL_KM, mixed_life_of, wear_life_of
from studies.run import over_drives

MARKS: Final = (0.25, 0.5, 0.75, 0.9)
DRAWS: Final = 1000  # of a bootstrap: misses of chance are told from real ones
SIMULATORS: Final[Mapping[str, Callable[[int], Life]]] = {
    "power law": life_of,
    "random wear": wear_life_of,
    "either": mixed_life_of,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """What was said at one age of a life: errors in km."""

    simulator: str
    stratum: str
    mark: float
    passed: float  # probability that was given to the truth's side
    crps: float
    line: float  # of the straight line through all results
    constant: float  # of a life of the usual length


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """What one life adds."""

    looks: tuple[Look, ...]
    years: float
    early_count: int  # times that "change now" was said before it was due


def told_of(case: tuple[str, int]) -> list[Told]:
    """Return what is said of the life of a simulator's seed."""
    simulator, seed = case
    life = SIMULATORS[simulator](seed)
    looks = tuple(look for mark in MARKS for look in _look(life, simulator, mark))
    return [Told(looks=looks, years=min(life.change_km, DRIVEN_KM) / KM_PER_YEAR, early_count=early_looks(life))]


def _look(life: Life, simulator: str, mark: float) -> Iterable[Look]:
    odometer_km = life.begin_km + mark * life.life_km
    when = passage_at(life, odometer_km) if odometer_km < DRIVEN_KM else None
    if when is None:
        return
    left_km = min(life.change_km - odometer_km, FARTHEST_KM)
    age_km = odometer_km - (0.0 if life.forgotten_km is not None else life.begin_km)
    line_km = float(whole_line(life.history.first(life.rows_until(odometer_km)))[0])
    yield Look(
        simulator=simulator,
        stratum=str(life.stratum),
        mark=mark,
        passed=when.within(left_km * M_PER_KM),
        crps=float(crps(when.quantiles_m(PROBABILITIES)[None] / M_PER_KM, np.array([left_km]))[0]),
        line=abs(line_km - left_km),
        constant=abs(max(USUAL_KM - age_km, 0.0) - left_km),
    )


def simulators_tables(seeds: Sequence[int], workers: int) -> list[Table]:
    """Return the tables of all simulators, the seeds' lives of each."""
    told = {name: over_drives(told_of, [(name, seed) for seed in seeds], workers) for name in SIMULATORS}
    return [_ages(told), _strata([look for own in told.values() for one in own for look in one.looks])]


def _ages(told: Mapping[str, Sequence[Told]]) -> Table:
    table = Table(
        "laws", "age", "lives", "inside 90 %", "CRPS", "line", "constant life", "over the better", 'false "now"'
    )
    for name, own in told.items():
        early, years = sum(one.early_count for one in own), sum(one.years for one in own)
        for mark in MARKS:
            looks = [look for one in own for look in one.looks if look.mark == mark]
            row = _row(looks)[:-1]
            table.add_row(
                name, f"{100 * mark:.0f} %", *row, f"{early} in {years:,.0f} years" if mark == MARKS[0] else ""
            )
    return table


def _strata(looks: Sequence[Look]) -> Table:
    table = Table(
        "laws",
        "life",
        *(f"at {100 * mark:.0f} %" for mark in MARKS),
        title="Inside 90 %, and CRPS over that of the better, with 90 % of what as many other lives would give",
    )
    for simulator, stratum in sorted({(one.simulator, one.stratum) for one in looks if one.simulator != "either"}):
        own = [one for one in looks if (one.simulator, one.stratum) == (simulator, stratum)]
        cells = (_row([one for one in own if one.mark == mark]) for mark in MARKS)
        table.add_row(simulator, stratum, *(f"{row[1]}, {row[5]}, {row[6]}" for row in cells))
    return table


def _row(looks: Sequence[Look]) -> tuple[str, ...]:
    """Return number, coverage, the three errors, ours over the better of the others, and that ratio's interval."""
    if not looks:
        return ("0", *6 * ("-",))
    errors = np.array([(one.crps, one.line, one.constant) for one in looks])
    covered = float(np.mean(is_covered(np.array([one.passed for one in looks]))))
    drawn = np.random.default_rng(1).integers(
        len(looks), size=(DRAWS, len(looks))
    )  # lives, with all that is said of them
    ratios = [float(means[0] / min(means[1:])) for means in (errors.mean(axis=0), *errors[drawn].mean(axis=1))]
    low, high = np.quantile(ratios[1:], (0.05, 0.95))
    shown = (f"{one:,.0f}" for one in errors.mean(axis=0))
    return (str(len(looks)), f"{100 * covered:.0f} %", *shown, f"{ratios[0]:.2f}", f"{low:.2f} to {high:.2f}")
