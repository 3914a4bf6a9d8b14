"""Results as rows, and as what libraries call a table."""

from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pytest
from matplotlib.colors import to_hex

from diag_service import Analysis, ShiftResult
from diag_service.api.analysis import ResultTable
from diag_service.api.picture import CONDITION_COLOUR
from diag_service.diagnosis.records import Condition
from tests.support.histories import history

TYPES = {"seq": "int64", "friction.mu_c": "float64", "reasons": "string", "complete": "bool"}
ROWS = [
    {"seq": 1, "friction.mu_c": 0.12, "reasons": "", "complete": True, "not a column": 1},
    {"seq": 2, "reasons": "interrupted;<b>", "complete": True},
]


def test_it_is_a_sequence_of_rows() -> None:
    table = ResultTable(TYPES, ROWS)
    assert len(table) == 2
    assert table[1] == {"seq": 2, "friction.mu_c": None, "reasons": "interrupted;<b>", "complete": True}
    assert [row["seq"] for row in table] == [1, 2]
    assert table.column("friction.mu_c") == [0.12, None]
    assert table.columns == tuple(TYPES)
    with pytest.raises(KeyError, match="mu_s"):
        table.column("mu_s")
    assert repr(table) == "<2 rows of 4 columns: seq, friction.mu_c, reasons, complete>"


def test_libraries_take_it_with_its_types() -> None:
    table = ResultTable(TYPES, ROWS)
    assert table.to_arrow().to_pylist() == list(table)
    assert pa.table(table).schema.types == [pa.int64(), pa.float64(), pa.string(), pa.bool_()]
    assert table.to_pandas()["seq"].tolist() == [1, 2]
    assert pl.DataFrame(table).to_dicts() == table.to_polars().to_dicts() == list(table)
    assert ResultTable(TYPES, []).to_arrow().schema == table.to_arrow().schema


def analysis_of(results: list[ShiftResult], *incomplete: str, name: str = "drive.log") -> Analysis:
    summary = {"vehicle": "car1", "complete": not incomplete, "incomplete": incomplete, "clutches": [], "order": ""}
    return Analysis(paths=(Path(name),), results=tuple(results), summary=summary)


def levels_and_words(results: list[ShiftResult]) -> list[tuple[list[float], str]]:
    """Return for each clutch the heights of the lines across its panel, and the words in it."""
    figure = analysis_of(results).plot()
    return [
        (
            [
                float(np.asarray(line.get_ydata())[0])
                for line in axes.lines
                if np.asarray(line.get_xdata()).tolist() == [0, 1]
            ],
            " ".join(text.get_text() for text in axes.texts),
        )
        for axes in figure.axes
    ]


def test_the_thresholds_of_the_verdict_are_drawn() -> None:
    for levels, words in levels_and_words(history(20)):
        assert levels == pytest.approx([0.9 * 0.14, 0.8 * 0.14])  # of new fluid, by the nominal calibration
        assert "mu_C below 90 % of new: watch" in words
        assert "mu_C below 80 % of new: change fluid" in words


def test_the_picture_of_a_part_of_a_drive_tells_no_verdict() -> None:
    for incomplete, is_told in (((), True), (("log_cut",), False)):
        axes = analysis_of(history(9), *incomplete).plot().axes[0]
        colours = {to_hex(strip.get_facecolor()) for strip in axes.patches}
        assert (colours != {CONDITION_COLOUR[Condition.NO_VERDICT]}) == is_told
