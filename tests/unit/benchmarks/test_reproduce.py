"""The report of the reproduction: its tables, its page, its studies on small numbers."""

import csv
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from string import Formatter

import numpy as np
import pytest

from benchmarks.reproduce.drives import FACTORS, Case, true_calibration
from benchmarks.reproduce.pictures import Picture
from benchmarks.reproduce.report import page, plain_table, study_table
from benchmarks.reproduce.study import CLUTCHES, Errors
from benchmarks.reproduce.tables import (
    PAPER_NOISELESS,
    Column,
    ColumnSet,
    Table,
    bound_columns,
    error_columns,
    keys_of,
    paper_columns,
)
from clutch_model.calibration import nominal_calibration

IDEAL = keys_of([Case.IDEAL])
ERRORS = Errors(
    percent={key: np.array([1.0, 3.0]) for key in IDEAL}, slope_right={(Case.IDEAL, clutch): 0.5 for clutch in CLUTCHES}
)


class Tags(HTMLParser):
    """Checks that tags are closed in order, and notes where they point."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.counts: dict[str, int] = {}
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.counts[tag] = self.counts.get(tag, 0) + 1
        self.addresses += [value or "" for name, value in attrs if name in {"src", "href"}]
        if tag not in {"meta", "img"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def table() -> Table:
    sets = [
        paper_columns(PAPER_NOISELESS),
        error_columns("here", ERRORS, is_random=True),
        bound_columns(dict.fromkeys(IDEAL, 0.144)),
    ]
    return Table("table-x", "A <caption>", IDEAL, sets)


def test_a_table_lines_its_column_sets_up() -> None:
    assert table().headings[:4] == ["parameter set", "clutch", "parameter", "error % (paper)"]
    assert table().rows[0] == ["ideal", "1", "µC", "+6.32", "+2.00", "1.41", "+1.0 .. +3.0", "50 %", "0.14"]
    assert table().rows[1][-2:] == ["", "0.14"]  # the slope stands once for both parameters


def test_a_further_column_set_needs_no_other_change() -> None:
    more = ColumnSet(title="another estimator", columns=[Column(heading="RMS %", cells={IDEAL[2]: "0.2"})])
    wider = Table("wider", "", IDEAL, [*table().sets, more])
    assert [row[-1] for row in wider.rows] == ["", "", "0.2", ""]
    assert "another estimator" in study_table(wider)


def test_a_wide_table_is_cut_between_column_sets() -> None:
    first, second = table().parts(5)
    assert [len(part.headings) - 3 for part in (first, second)] == [5, 1]
    assert [one.title for one in [*first.sets, *second.sets]] == [one.title for one in table().sets]
    assert len(table().parts(6)) == 1


def test_a_table_is_written_as_csv(tmp_path: Path) -> None:
    with table().write_csv(tmp_path).open(encoding="utf-8") as stream:
        assert list(csv.reader(stream)) == [table().headings, *table().rows]


def test_the_page_needs_nothing_but_itself() -> None:
    text = "# Title & more\n\nA paragraph\nin two lines.\n\n## Heading\n\n[[one]]\n\n[[two]]"
    tables = {"one": study_table(table()), "two": plain_table("Plain", ["a"], [["<1>"]])}
    html = page(text, tables, [Picture(number=5, caption="µ < 1", png=b"\x89PNG")])
    tags = Tags()
    tags.feed(html)
    assert tags.open == []
    assert (tags.counts["table"], tags.counts["img"], tags.counts["p"], tags.counts["h2"]) == (2, 1, 1, 2)
    assert [address.partition(";")[0] for address in tags.addresses] == ["data:image/png"]
    assert "<title>Title &amp; more</title>" in html
    assert "&lt;1&gt;" in html


def test_the_text_calls_every_table_once() -> None:
    text = files("benchmarks.reproduce").joinpath("report.md").read_text(encoding="utf-8")
    called = [block.strip("[]\n") for block in text.split("\n\n") if block.startswith("[[")]
    assert sorted(called) == sorted(
        ["table-2", "table-3", "table-a1", "table-a2", "what-passes", "readings", "vehicle-route"]
    )
    fields = {name for _, name, _, _ in Formatter().parse(text) if name}
    assert {"factor_min", "pull_max", "slope_sentence"} <= fields


@pytest.mark.parametrize("case", list(Case))
def test_the_parameter_sets_scale_the_nominal_friction(case: Case) -> None:
    for clutch, nominal in zip(true_calibration(case).clutches, nominal_calibration().clutches, strict=True):
        found = (clutch.friction.mu_c / nominal.friction.mu_c, clutch.friction.mu_s / nominal.friction.mu_s)
        assert found == pytest.approx(FACTORS[case])
        assert (clutch.friction.mu_c > clutch.friction.mu_s) == (case is not Case.CASE_2)
