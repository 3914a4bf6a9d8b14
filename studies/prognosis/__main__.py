"""How good prognoses are on simulated lives of clutches, beside four simpler ways to foretell.

    python -m studies.prognosis --lives 200 --jobs 2
    python -m studies.prognosis --kinds --lives 400          # even, in bursts, after a fill, with a late knee

Numbers of the prognosis were chosen on seeds below 2000, two of them after a look at 100000 and 200000;
docs/accuracy.md has what later ones say.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from canlog.arrays import FloatArray
from clutch_results.prognosis import Passage, prognose
from clutch_results.prognosis.changes import fluid_starts
from diag_service.diagnosis.condition.thresholds import Cause, given_at
from studies.prognosis.baselines import (
    FARTHEST_KM,
    PROBABILITIES,
    crps,
    fixed_interval,
    fleet,
    is_covered,
    is_near,
    logistic_index,
    whole_line,
)
from studies.prognosis.kinds import kind_looks, kinds_table, oracles_table
from studies.prognosis.lives import DRIVEN_KM, KM_PER_YEAR, REFERENCE, Life, Stratum, life_km_of, life_of
from studies.run import over_drives, parsed, processor_s, study_parser

MARKS: Final = (0.25, 0.5, 0.75)
LATE_MARKS: Final = (0.8, 0.85, 0.9, 0.95)
LOOK_KM: Final = 7_500.0  # every half year somebody asks whether the fluid has to be changed now
LATEST_KM: Final = 10_000.0  # after the limit, when it should have been said
FOUND_WITHIN: Final = 15  # results after a forgotten fill
M_PER_KM: Final = 1000.0
LIVES = 300
FIRST_SEED = 240_000  # no number was chosen by seeds from here on
FLEET_SEEDS = range(500, 700)  # whose lives the fleet's baseline knows
WIDTH = 150


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoredForecast:
    """What was said at one age of one fluid, and what was true: distances until the change is due [km]."""

    stratum: StrEnum
    mark: float
    life_km: float
    left_km: float
    passed: float  # probability that was given to the truth's side
    methods: tuple[FloatArray, ...]  # quantiles: ours, then the baselines in the order of `METHODS`

    @property
    def median_km(self) -> float:
        """Ours."""
        return float(np.median(self.methods[0]))


METHODS: Final = ("prognosis", "fixed interval", "whole line", "logistic index", "fleet")


@dataclass(frozen=True, slots=True, kw_only=True)
class KindAccount:
    """What one life adds to the counts."""

    forecasts: tuple[ScoredForecast, ...]
    years: float  # driven before the change was due
    early_count: int  # times that "change now" was said in them
    is_told: bool | None  # whether it is said when overdue; None: the life ends before
    found_rows: int | None  # results from a forgotten fill to its finding; None: there was none
    is_lost: bool  # there was one, and it was not found in time
    false_count: int  # fills found that never were
    all_years: float


def account_of(life: Life, lives_km: FloatArray) -> KindAccount:
    """Return the account of a life; the fleet baseline knows the lives of others."""
    forecasts = tuple(_forecasts(life, lives_km))
    overdue_km = life.change_km + LATEST_KM
    found_rows, false_count = found_fills(life)
    return KindAccount(
        forecasts=forecasts,
        years=min(life.change_km, DRIVEN_KM) / KM_PER_YEAR,
        early_count=early_looks(life),
        is_told=_is_due(life, overdue_km) if overdue_km < DRIVEN_KM else None,
        found_rows=found_rows,
        is_lost=life.forgotten_km is not None and found_rows is None,
        false_count=false_count,
        all_years=DRIVEN_KM / KM_PER_YEAR,
    )


def early_looks(life: Life) -> int:
    """Return how often "change now" was said anew before it was due."""
    looks = [km for km in np.arange(LOOK_KM, DRIVEN_KM, LOOK_KM).tolist() if km < life.change_km]
    said = [_is_due(life, km) for km in looks]
    return sum(now and not before for before, now in zip([False, *said], said, strict=False))


def passage_at(life: Life, odometer_km: float) -> Passage | None:
    """Return what is said of the change of the fluid at an odometer."""
    history = life.history.first(life.rows_until(odometer_km))
    found = prognose(1, history, REFERENCE)
    return None if found.change_fluid is None else found.change_fluid.passage


def _is_due(life: Life, odometer_km: float) -> bool:
    when = passage_at(life, odometer_km)
    return when is not None and when.within(0.0) >= given_at()[Cause.SHUDDER]


def _forecasts(life: Life, lives_km: FloatArray) -> list[ScoredForecast]:
    forecasts = []
    for mark in (*MARKS, *LATE_MARKS):
        odometer_km = life.begin_km + mark * life.life_km
        when = passage_at(life, odometer_km) if odometer_km < DRIVEN_KM else None
        if when is None:
            continue
        history = life.history.first(life.rows_until(odometer_km))
        left_km = min(life.change_km - odometer_km, FARTHEST_KM)
        age_km = odometer_km - (0.0 if life.forgotten_km is not None else life.begin_km)
        forecasts.append(
            ScoredForecast(
                stratum=life.stratum,
                mark=mark,
                life_km=life.life_km,
                left_km=left_km,
                passed=when.within(left_km * M_PER_KM),
                methods=(
                    when.quantiles_m(PROBABILITIES) / M_PER_KM,
                    fixed_interval(age_km),
                    whole_line(history),
                    logistic_index(history),
                    fleet(age_km, lives_km),
                ),
            )
        )
    return forecasts


def found_fills(life: Life) -> tuple[int | None, int]:
    """Return with which result after it a forgotten fill is found, if in time, and how many found ones never were."""
    whole = [start for start in fluid_starts(life.history) if not start.is_noted]
    if life.forgotten_km is None:
        return None, len(whole)
    filled = life.rows_until(life.forgotten_km)
    in_time = fluid_starts(life.history.first(filled + FOUND_WITHIN))
    near = [start for start in in_time if not start.is_noted and start.noticed_row >= filled]
    wrong = [start for start in whole if abs(start.row - filled) > FOUND_WITHIN]
    return (near[0].noticed_row - filled + 1 if near else None), len(wrong)


def of_marks(forecasts: Sequence[ScoredForecast], *marks: float) -> list[ScoredForecast]:
    """Return the forecasts made at some shares of the lives."""
    return [one for one in forecasts if one.mark in marks]


def coverage(forecasts: Sequence[ScoredForecast]) -> float:
    """Return how often the truth lay inside the interval."""
    return float(np.mean(is_covered(np.array([one.passed for one in forecasts])))) if forecasts else float("nan")


def mean_crps(forecasts: Sequence[ScoredForecast], method: int) -> float:
    """Return the mean CRPS of a method [km]."""
    if not forecasts:
        return float("nan")
    quantiles = np.array([one.methods[method] for one in forecasts])
    return float(np.mean(crps(quantiles, _left(forecasts))))


def marks_table(forecasts: Sequence[ScoredForecast]) -> Table:
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


def strata_table(forecasts: Sequence[ScoredForecast]) -> Table:
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


def counts_table(accounts: Sequence[KindAccount]) -> Table:
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


def _left(forecasts: Sequence[ScoredForecast]) -> FloatArray:
    return np.array([one.left_km for one in forecasts])


def _half_width(forecasts: Sequence[ScoredForecast]) -> float:
    """Return half of the 90 % interval over the life, the median over forecasts."""
    widths = [float(np.diff(np.quantile(one.methods[0], (0.05, 0.95)))[0]) / one.life_km for one in forecasts]
    return 0.5 * float(np.median(widths)) if widths else float("nan")


def accounts_of(lives_km: tuple[float, ...], seed: int) -> list[KindAccount]:
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
