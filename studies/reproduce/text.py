"""What the report says: its tables, and the numbers in its sentences."""

from collections.abc import Mapping
from importlib.resources import files

import numpy as np

from studies.reproduce.drives import PaperCase
from studies.reproduce.findings import PaperFindings
from studies.reproduce.report import EVIDENCE_HEADINGS, evidence_rows, plain_table, study_table
from studies.reproduce.study import CLUTCHES, Errors, Key
from studies.reproduce.tables import (
    PAPER_NOISELESS,
    PAPER_NOISY,
    SYMBOL,
    ColumnSet,
    PaperTable,
    bound_columns,
    error_columns,
    keys_of,
    paper_columns,
    truth_columns,
)

IDEAL_ONLY = [PaperCase.IDEAL]
READING_KEYS = keys_of([PaperCase.IDEAL, PaperCase.CASE_2])


def study_tables(found: PaperFindings) -> list[PaperTable]:
    """Return Tables 2, 3, A.1 and A.2 of the paper and that of the vehicle route."""
    truth, every = truth_columns(found.drives), list(PaperCase)
    noiseless_sets: list[ColumnSet] = [
        truth,
        paper_columns(PAPER_NOISELESS),
        error_columns("static film table", found.noiseless, is_random=False),
        error_columns("trajectory film table", found.noiseless_trajectory, is_random=False),
        error_columns("simulated film", found.noiseless_known_film, is_random=False),
    ]
    noisy_sets: list[ColumnSet] = [
        truth,
        paper_columns(PAPER_NOISY),
        error_columns("here", found.noisy, is_random=True),
        bound_columns(found.bounds),
    ]
    vehicle_sets = [truth, error_columns("vehicle route", found.can, is_random=True)]
    runs = f"{len(found.seeds)} draws of the noise"
    can_caption = f"CAN frames, sensor noise only, {len(found.can_seeds)} drives of {found.cycles} cycles per set"
    return [
        PaperTable("table-2", "Table 2: ideal set, noiseless", keys_of(IDEAL_ONLY), noiseless_sets),
        PaperTable("table-3", f"Table 3: ideal set, noisy, {runs}", keys_of(IDEAL_ONLY), noisy_sets),
        PaperTable("table-a1", "Table A.1: all sets, noiseless", keys_of(every), noiseless_sets),
        PaperTable("table-a2", f"Table A.2: all sets, noisy, {runs}", keys_of(every), noisy_sets),
        PaperTable("vehicle-route", can_caption, keys_of(every), vehicle_sets),
    ]


def html_tables(found: PaperFindings, tables: list[PaperTable]) -> dict[str, str]:
    """Return every table of the report as HTML, by the name that the text calls it."""
    few = f"means over {len(found.reading_seeds)} draws of the noise"
    return {table.name: study_table(table) for table in tables} | {
        "what-passes": plain_table(f"What lies behind µS, {few}", EVIDENCE_HEADINGS, evidence_rows(found.evidence)),
        "readings": plain_table(f"Other readings, {few}", reading_headings(), reading_rows(found)),
    }


def written(found: PaperFindings) -> str:
    """Return the text of the report with the findings' numbers in it."""
    template = files("studies.reproduce").joinpath("report.md").read_text(encoding="utf-8")
    return template.format(**_general(found), **_noiseless(found), **_case_2(found))


def reading_headings() -> list[str]:
    """Return the headings of the table of readings."""
    return ["reading", *(f"{case.value}: {SYMBOL[name]}{clutch}" for case, clutch, name in READING_KEYS)]


def reading_rows(found: PaperFindings) -> list[list[str]]:
    """Return the table of readings as texts."""
    return [[one.name, *(_signed(one.errors.mean(key)) for key in READING_KEYS)] for one in found.readings]


def rms(errors: Errors, key: Key) -> float:
    """Return the root mean square error."""
    return float(np.sqrt(np.mean(errors.percent[key] ** 2)))


def _general(found: PaperFindings) -> Mapping[str, object]:
    factors = [rms(found.noisy, key) / found.bounds[key] for key in keys_of(list(PaperCase))]
    ideal = keys_of(IDEAL_ONLY)
    return {
        "cycles": found.cycles,
        "rows": len(found.drives[0].rows),
        "few": len(found.reading_seeds),
        "factor_min": min(factors),
        "factor_max": max(factors),
        "rms_list": ", ".join(f"{rms(found.noisy, key):.1f}" for key in ideal),
        "bound_list": ", ".join(f"{found.bounds[key]:.2f}" for key in ideal),
        "pull_min": min(one.pull for one in found.evidence),
        "pull_max": max(one.pull for one in found.evidence),
    }


def _noiseless(found: PaperFindings) -> Mapping[str, object]:
    values: dict[str, object] = {
        "noiseless_worst": max(abs(found.noiseless.mean(key)) for key in keys_of(IDEAL_ONLY)),
        "known_worst": max(abs(found.noiseless_known_film.mean(key)) for key in keys_of(IDEAL_ONLY)),
        "static_mu_s_worst": max(
            abs(found.noiseless.mean(key)) for key in keys_of(list(PaperCase)) if key[2] == "mu_s"
        ),
    }
    for clutch in CLUTCHES:
        values[f"static_mu_c{clutch}"] = found.noiseless.mean((PaperCase.IDEAL, clutch, "mu_c"))
        values[f"trajectory_mu_c{clutch}"] = found.noiseless_trajectory.mean((PaperCase.IDEAL, clutch, "mu_c"))
    wrong = [
        f"{case.value}, clutch {clutch}" for (case, clutch), share in found.noiseless.slope_right.items() if not share
    ]
    values["slope_sentence"] = (
        f"The slope has the wrong sign in {' and '.join(wrong)}: there µC and µS differ by less than the error of µC."
        if wrong
        else "The slope has the right sign in every set."
    )
    return values


def _case_2(found: PaperFindings) -> Mapping[str, object]:
    values: dict[str, object] = {}
    evidence = {one.clutch: one for one in found.evidence if one.case == PaperCase.CASE_2}
    for clutch in CLUTCHES:
        one = evidence[clutch]
        values |= {
            f"case2_mu_s{clutch}": found.noisy.mean((PaperCase.CASE_2, clutch, "mu_s")),
            f"case2_right{clutch}": 100.0 * found.noisy.slope_right[PaperCase.CASE_2, clutch],
            f"locked{clutch}": 100.0 * one.locked_share,
            f"slow{clutch}": 100.0 * one.slow_share,
            f"ungated{clutch}": one.ungated_mean_percent,
            f"scatter{clutch}": one.ungated_std_percent,
        }
    return values


def _signed(value: float) -> str:
    return "none" if np.isnan(value) else f"{value:+.1f}"
