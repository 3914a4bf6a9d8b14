"""What limits the median half-way: lives without one trouble after the other, for the prognosis and the oracle."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from rich.table import Table

from studies.prognosis.lives import DRIVEN_KM, ERRORS, Errors, life_of
from studies.prognosis.oracle import oracle
from studies.prognosis.scores import is_near
from studies.prognosis.truth import REFERENCE, STRATA, Stratum
from diag_service.diagnosis.prognosis import prognose

HALF: Final = 0.5
M_PER_KM: Final = 1000.0
BENDS: Final = frozenset({Stratum.KNEE, Stratum.LOAD})
LITTLE: Final = 1e-5
CASES: Final = {
    "everything": (ERRORS, frozenset[Stratum]()),
    "one result in 40 km instead of 10": (replace(ERRORS, row_km=40.0), frozenset[Stratum]()),
    "no random errors": (replace(ERRORS, worse=(0.05, 0.05), drive=(LITTLE, LITTLE)), frozenset[Stratum]()),
    "mu_S and mu_C wrong alike": (replace(ERRORS, split_new=LITTLE, split_gone=LITTLE), frozenset[Stratum]()),
    "no bends, no change of load": (ERRORS, BENDS),
    "neither": (
        replace(ERRORS, worse=(0.05, 0.05), drive=(LITTLE, LITTLE), split_new=LITTLE, split_gone=LITTLE),
        BENDS,
    ),
}
Each = Callable[[Callable[[int], tuple[bool, bool] | None], list[int]], list[tuple[bool, bool] | None]]


def half_way(seed: int, errors: Errors) -> tuple[bool, bool] | None:
    """Return whether the medians of prognosis and oracle are near half-way through a life; None: it is not driven."""
    life = life_of(seed, errors)
    odometer_km = life.begin_km + HALF * life.life_km
    if odometer_km >= DRIVEN_KM:
        return None
    found = prognose(1, life.history.first(life.rows_until(odometer_km)), REFERENCE)
    if found.change_fluid is None:
        return None
    left_km = np.array([life.change_km - odometer_km])
    medians = [
        one.quantiles_m(np.array([0.5])) for one in (found.change_fluid.passage, oracle(life, odometer_km, errors))
    ]
    ours, best = (bool(is_near(median / M_PER_KM, left_km)[0]) for median in medians)
    return ours, best


def decomposition_table(seeds: range, each: Each) -> Table:
    """Return how often the median is near half-way, without one trouble after the other."""
    table = Table(
        "lives with", "lives", "prognosis", "oracle", title="Median within 20 % of what remains at 50 % of life"
    )
    for name, (errors, without) in CASES.items():
        chosen = [seed for seed in seeds if STRATA[seed % len(STRATA)] not in without]
        near = [one for one in each(partial(half_way, errors=errors), chosen) if one is not None]
        shares = [f"{100.0 * float(np.mean([one[which] for one in near])):.0f} %" for which in range(2)]
        table.add_row(name, str(len(near)), *shares)
    return table
