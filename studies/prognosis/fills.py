"""How soon forgotten fills are found, beside an oracle that knows the friction before each and its errors.

The oracle sees the fifteen results after the fill alone; it knows what they would be without it, how far single
results and drives scatter in this very vehicle, and asks as much as the search asks before it believes.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from rich.table import Table
from scipy.stats import ncx2

from studies.prognosis.evaluation import FOUND_WITHIN, found_fills
from studies.prognosis.lives import DRIVEN_KM, ERRORS, Life, life_of
from studies.prognosis.truth import KM_PER_YEAR
from canlog.arrays import FloatArray
from diag_service.diagnosis.prognosis.changes import STEP_CHI_SQUARE

STEPS: Final = 2  # of mu_C and mu_S
M_PER_KM: Final = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FillAccount:
    """What one life adds to the counts."""

    found_rows: int | None  # results from a forgotten fill to its finding, if in time
    oracle: float | None  # the probability that the oracle finds it; None: there was none
    false_count: int  # fills found that never were


def fill_account_of(seed: int) -> FillAccount:
    """Return what was found in the life of a seed."""
    life = life_of(seed)
    found_rows, false_count = found_fills(life)
    oracle = None if life.forgotten_km is None else float(ncx2.sf(STEP_CHI_SQUARE, STEPS, distance_of(life)))
    return FillAccount(found_rows=found_rows, oracle=oracle, false_count=false_count)


def distance_of(life: Life) -> float:
    """Return the chi-square that the true step of a forgotten fill has over the errors of the results after it."""
    truth, past = life.truth, life.history
    at = int(np.searchsorted(truth.road_km, life.begin_km))
    step = np.array([mu[at] / mu[at - 1] - 1.0 for mu in (truth.mu_c, truth.mu_s)])
    first = life.rows_until(life.begin_km)
    rows = slice(first, first + FOUND_WITHIN)
    stds = (past.random_std_mu_c[rows] / past.mu_c[rows], past.random_std_mu_s[rows] / past.mu_s[rows])
    single = [1.0 / float(np.sum((truth.noise_ratio * std) ** -2.0)) for std in stds]
    drives = len(np.unique((past.odometer_m[rows] / M_PER_KM / ERRORS.drive_km).astype(np.int64)))
    covariance = np.diag(single) + _drive() / drives
    return float(step @ np.linalg.solve(covariance, step))


def _drive() -> FloatArray:
    one, other = ERRORS.drive
    both = ERRORS.drive_correlation * one * other
    return np.array([[one**2, both], [both, other**2]])


def fills_table(accounts: list[FillAccount]) -> Table:
    """Return how many fills were found in time, and what never was."""
    forgotten = [one for one in accounts if one.oracle is not None]
    rows = [one.found_rows for one in forgotten if one.found_rows is not None]
    false, years = sum(one.false_count for one in accounts), len(accounts) * DRIVEN_KM / KM_PER_YEAR
    table = Table("what", "figure", title=f"Forgotten fills in {len(accounts)} lives")
    share = 100.0 * len(rows) / max(len(forgotten), 1)
    table.add_row(f"found within {FOUND_WITHIN} results", f"{len(rows)} of {len(forgotten)}, {share:.1f} %")
    oracle = 100.0 * float(np.mean([one.oracle for one in forgotten])) if forgotten else float("nan")
    table.add_row("by the oracle", f"{oracle:.1f} %")
    table.add_row("results until they were found, mean", f"{float(np.mean(rows)):.1f}" if rows else "-")
    table.add_row("found that never were", f"{false} in {years:,.0f} years, {100.0 * false / years:.2f} % of them")
    return table
