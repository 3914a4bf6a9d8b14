"""How good prognoses are on simulated lives of clutches, beside four simpler ways to foretell.

    python -m benchmarks.prognosis --lives 200 --seed 50000

Numbers of the prognosis were chosen on seeds below 1000; docs/prognosis.md has what seeds from 50000 say.
"""

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.measuring import processor_s
from benchmarks.prognosis.evaluation import LATE_MARKS, MARKS, METHODS, Account, Forecast, account_of
from benchmarks.prognosis.lives import Stratum, life_km_of, life_of
from benchmarks.prognosis.scores import crps, is_covered, is_near
from canlog.arrays import FloatArray

LIVES = 200
FIRST_SEED = 50_000  # no number was chosen by seeds from here on
FLEET_SEEDS = range(500, 700)  # whose lives the fleet's baseline knows
WIDTH = 120


def of_marks(forecasts: Sequence[Forecast], *marks: float) -> list[Forecast]:
    """Return the forecasts made at some shares of the lives."""
    return [one for one in forecasts if one.mark in marks]


def coverage(forecasts: Sequence[Forecast]) -> float:
    """Return how often the truth lay inside the interval."""
    return float(np.mean(is_covered(np.array([one.passed for one in forecasts])))) if forecasts else float("nan")


def mean_crps(forecasts: Sequence[Forecast], method: int) -> float:
    """Return the mean CRPS of a method [km]."""
    if not forecasts:
        return float("nan")
    quantiles = np.array([one.methods[method] for one in forecasts])
    return float(np.mean(crps(quantiles, _left(forecasts))))


def marks_table(forecasts: Sequence[Forecast]) -> Table:
    """Return what is said at each share of the lives."""
    table = Table(
        "age", "forecasts", "inside 90 %", "half width", "median near", *(f"CRPS {name}" for name in METHODS),
        title="All lives; near: within 20 % of what remains (alpha-lambda); CRPS in km",
    )  # fmt: skip
    for mark in MARKS:
        chosen = of_marks(forecasts, mark)
        median = np.array([one.median_km for one in chosen])
        table.add_row(
            f"{100.0 * mark:.0f} %",
            str(len(chosen)),
            f"{100.0 * coverage(chosen):.1f} %",
            f"{_half_width(chosen):.2f} of life",
            f"{100.0 * float(np.mean(is_near(median, _left(chosen)))):.0f} %",
            *(f"{mean_crps(chosen, method):,.0f}" for method in range(len(METHODS))),
        )
    return table


def strata_table(forecasts: Sequence[Forecast]) -> Table:
    """Return what is said of each kind of life."""
    ages = [f"{100.0 * mark:.0f} %" for mark in MARKS]
    table = Table(
        "lives", "forecasts", *(f"inside at {age}" for age in ages), "all", *(f"CRPS {name}" for name in METHODS),
        title="By kind of life: share of truths inside the 90 % interval; CRPS in km",
    )  # fmt: skip
    for stratum in Stratum:
        own = [one for one in of_marks(forecasts, *MARKS) if one.stratum is stratum]
        table.add_row(
            stratum.value,
            str(len(own)),
            *(f"{100.0 * coverage(of_marks(own, mark)):.0f} %" for mark in MARKS),
            f"{100.0 * coverage(own):.0f} %",
            *(f"{mean_crps(own, method):,.0f}" for method in range(len(METHODS))),
        )
    return table


def counts_table(accounts: Sequence[Account]) -> Table:
    """Return what was said too early or too late, and which fills were found."""
    late = of_marks([one for account in accounts for one in account.forecasts], MARKS[-1], *LATE_MARKS)
    error = np.array([(one.median_km - one.left_km) / one.life_km for one in late])
    years, all_years = sum(one.years for one in accounts), sum(one.all_years for one in accounts)
    told = [one.is_told for one in accounts if one.is_told is not None]
    rows = [one.found_rows for one in accounts if one.found_rows is not None]
    lost = sum(one.is_lost for one in accounts)
    early, false = sum(one.early_count for one in accounts), sum(one.false_count for one in accounts)
    table = Table("what", "figure", title="Last quarter, alarms, forgotten fills")
    table.add_row("bias of the median in the last quarter", f"{100.0 * float(np.mean(error)):+.1f} % of life")
    table.add_row('false "change now" per vehicle and year', f"{early / years:.4f} ({early} in {years:,.0f} years)")
    table.add_row('"change now" said 10,000 km after it was due', f"{sum(told)} of {len(told)}")
    table.add_row("forgotten fills found within 15 results", f"{len(rows)} of {len(rows) + lost}")
    table.add_row("results until they were found, mean", f"{float(np.mean(rows)):.1f}" if rows else "-")
    table.add_row(
        "fills found that never were", f"{false} in {all_years:,.0f} years ({false / len(accounts):.3f} a life)"
    )
    return table


def _left(forecasts: Sequence[Forecast]) -> FloatArray:
    return np.array([one.left_km for one in forecasts])


def _half_width(forecasts: Sequence[Forecast]) -> float:
    """Return half of the 90 % interval over the life, the median over forecasts."""
    widths = [float(np.diff(np.quantile(one.methods[0], (0.05, 0.95)))[0]) / one.life_km for one in forecasts]
    return 0.5 * float(np.median(widths)) if widths else float("nan")


def account_of_seed(seed: int, lives_km: FloatArray) -> Account:
    """Return what a life adds to the counts."""
    return account_of(life_of(seed), lives_km)


def main(argv: Sequence[str] | None = None) -> int:
    """Simulate lives, foretell, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lives", type=int, default=LIVES)
    parser.add_argument("--seed", type=int, default=FIRST_SEED, help="of the first life")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    arguments = parser.parse_args(argv)
    began_s = processor_s()
    lives_km = np.array([life_km_of(seed) for seed in FLEET_SEEDS])
    seeds = range(arguments.seed, arguments.seed + arguments.lives)
    if arguments.jobs > 1:
        with ProcessPoolExecutor(arguments.jobs) as pool:
            accounts = list(pool.map(partial(account_of_seed, lives_km=lives_km), seeds))
    else:
        accounts = [account_of_seed(seed, lives_km) for seed in seeds]
    forecasts = [one for account in accounts for one in account.forecasts]
    console = Console(markup=False, width=WIDTH)
    console.print(f"{arguments.lives} lives, seeds from {arguments.seed}; {len(Stratum)} kinds")
    for table in (marks_table(forecasts), strata_table(forecasts), counts_table(accounts)):
        console.print(table)
    console.print(f"{processor_s() - began_s:.0f} s of processor time")
    return 0


if __name__ == "__main__":
    sys.exit(main())
