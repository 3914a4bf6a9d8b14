"""Tables with one row per parameter set, clutch and parameter; every column set comes from a study of its own."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from studies.reproduce.drives import PaperCase, PaperDrive
from studies.reproduce.study import CLUTCHES, PARAMETERS, Errors, Key, true_value

SYMBOL = {"mu_c": "µC", "mu_s": "µS"}

# The paper's text gives numbers for the ideal set only; of the others it says what is below 10 %.
PAPER_NOISELESS = {
    (PaperCase.IDEAL, 1, "mu_c"): "+6.32",
    (PaperCase.IDEAL, 1, "mu_s"): "-4.92",
    (PaperCase.IDEAL, 2, "mu_c"): "+2.41",
    (PaperCase.IDEAL, 2, "mu_s"): "-7.87",
}
PAPER_NOISY = {
    (PaperCase.IDEAL, 1, "mu_c"): "+7.49",
    (PaperCase.IDEAL, 1, "mu_s"): "-0.75",
    (PaperCase.IDEAL, 2, "mu_c"): "+5.35",
    (PaperCase.IDEAL, 2, "mu_s"): "-2.56",
}
ABOVE, BELOW = "above 10", "below 10"


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperColumn:
    """One column: a heading and a text for each row."""

    heading: str
    cells: Mapping[Key, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnSet:
    """Columns that belong together under one title."""

    title: str
    columns: Sequence[PaperColumn]


@dataclass(frozen=True, slots=True)
class PaperTable:
    """A table of the report, also written as CSV."""

    name: str
    caption: str
    keys: Sequence[Key]
    sets: Sequence[ColumnSet]

    @property
    def headings(self) -> list[str]:
        """Headings of all columns, those of the rows first."""
        return [
            "parameter set",
            "clutch",
            "parameter",
            *(column.heading for one in self.sets for column in one.columns),
        ]

    @property
    def rows(self) -> list[list[str]]:
        """Texts of all rows."""
        return [
            [
                key[0].value,
                str(key[1]),
                SYMBOL[key[2]],
                *(column.cells.get(key, "") for one in self.sets for column in one.columns),
            ]
            for key in self.keys
        ]


def write_csv(path: Path, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Write a table as CSV."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([headings, *rows])


def keys_of(cases: Sequence[PaperCase]) -> list[Key]:
    """Return the rows of a table over parameter sets."""
    return [(case, clutch, parameter) for case in cases for clutch in CLUTCHES for parameter in PARAMETERS]


def truth_columns(drives: Sequence[PaperDrive]) -> ColumnSet:
    """Return the true values."""
    cells = {
        (drive.case, clutch, parameter): f"{true_value(drive, clutch, parameter):.4f}"
        for drive in drives
        for clutch in CLUTCHES
        for parameter in PARAMETERS
    }
    return ColumnSet(title="truth", columns=[PaperColumn(heading="true value", cells=cells)])


def paper_columns(printed: Mapping[Key, str]) -> ColumnSet:
    """Return the paper's own figures, as far as its text gives them."""
    cells = {
        key: printed.get(key, ABOVE if key[0] is PaperCase.CASE_2 and key[2] == "mu_c" else BELOW)
        for key in keys_of(list(PaperCase))
    }
    return ColumnSet(title="the paper", columns=[PaperColumn(heading="error % (paper)", cells=cells)])


def error_columns(title: str, errors: Errors, *, is_random: bool) -> ColumnSet:
    """Return mean error, with noise also scatter and extremes, and how often the slope has the right sign."""
    mean = PaperColumn(heading=f"error % ({title})", cells={key: f"{errors.mean(key):+.2f}" for key in errors.percent})
    slope = PaperColumn(
        heading="slope sign right",
        cells={
            key: f"{100.0 * errors.slope_right[key[0], key[1]]:.0f} %"
            for key in errors.percent
            if key[2] == PARAMETERS[0]
        },
    )
    if not is_random:
        return ColumnSet(title=title, columns=[mean, slope])
    scatter = PaperColumn(heading="std %", cells={key: f"{errors.std(key):.2f}" for key in errors.percent})
    extremes = PaperColumn(
        heading="from .. to %",
        cells={key: f"{min(one):+.1f} .. {max(one):+.1f}" if len(one) else "" for key, one in errors.percent.items()},
    )
    return ColumnSet(title=title, columns=[mean, scatter, extremes, slope])


def bound_columns(bounds: Mapping[Key, float]) -> ColumnSet:
    """Return the Cramer-Rao bound."""
    cells = {key: f"{bound:.2f}" for key, bound in bounds.items()}
    return ColumnSet(
        title="Cramér-Rao bound, slip known", columns=[PaperColumn(heading="least std % (bound)", cells=cells)]
    )
