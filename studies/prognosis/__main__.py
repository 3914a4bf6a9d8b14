"""How good prognoses are on simulated lives of clutches, beside four simpler ways to foretell.

    python -m studies.prognosis --lives 200 --jobs 2
    python -m studies.prognosis --kinds --lives 400          # even, in bursts, after a fill, with a late knee

Numbers of the prognosis were chosen on seeds below 2000, two of them after a look at 100000 and 200000;
docs/prognosis.md has what later ones say.
"""

import sys
from collections.abc import Sequence
from functools import partial

import numpy as np
from rich.console import Console
from rich.table import Table

from canlog.arrays import FloatArray
from studies.prognosis.baselines import crps, is_covered, is_near
from studies.prognosis.evaluation import LATE_MARKS, MARKS, METHODS, Account, Forecast, account_of
from studies.prognosis.kinds import kind_looks, kinds_table, oracles_table
from studies.prognosis.lives import Stratum, life_km_of, life_of
from studies.run import over_drives, parsed, processor_s, study_parser

LIVES = 300
FIRST_SEED = 240_000  # no number was chosen by seeds from here on
FLEET_SEEDS = range(500, 700)  # whose lives the fleet's baseline knows
WIDTH = 150


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


def accounts_of(lives_km: tuple[float, ...], seed: int) -> list[Account]:
    """Return what a life adds to the counts."""
    return [account_of(life_of(seed), np.array(lives_km))]


def _study(console: Console, seeds: range, workers: int) -> None:
    lives_km = tuple(life_km_of(seed) for seed in FLEET_SEEDS)
    accounts = over_drives(partial(accounts_of, lives_km), seeds, workers)
    forecasts = [one for account in accounts for one in account.forecasts]
    console.print(f"{len(seeds)} lives, seeds from {seeds[0]}; {len(Stratum)} kinds")
    for table in (marks_table(forecasts), strata_table(forecasts), counts_table(accounts)):
        console.print(table)


def main(argv: Sequence[str] | None = None) -> int:
    """Simulate lives, foretell, print."""
    parser = study_parser(__doc__, seed=FIRST_SEED)
    parser.add_argument("--lives", type=int, default=LIVES)
    parser.add_argument("--kinds", action="store_true", help="four kinds of lives by plain laws, beside two rivals")
    arguments = parsed(parser, argv, lives=20)
    began_s = processor_s()
    console = Console(markup=False, width=WIDTH)
    seeds = range(arguments.seed, arguments.seed + arguments.lives)
    if arguments.kinds:
        kinds = over_drives(kind_looks, seeds, arguments.workers, arguments.kept)
        console.print(kinds_table(kinds), oracles_table(kinds))
    else:
        _study(console, seeds, arguments.workers)
    console.print(f"{processor_s() - began_s:.0f} s of processor time")
    return 0


if __name__ == "__main__":
    sys.exit(main())
