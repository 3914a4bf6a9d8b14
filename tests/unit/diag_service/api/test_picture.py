"""What the picture of an analysis shows."""

from dataclasses import replace

import numpy as np
import pytest

from diag_service import Analysis, ShiftResult
from tests.support.histories import history


def levels_and_words(results: list[ShiftResult]) -> list[tuple[list[float], str]]:
    """Return for each clutch the heights of the lines across its panel, and the words in it."""
    figure = Analysis(paths=(), results=tuple(results), summary={"vehicle": "car1"}).plot()
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


def test_without_a_level_there_is_no_threshold() -> None:
    unknown = [replace(one, verdict=replace(one.verdict, level_ratio=None)) for one in history(4)]
    assert levels_and_words(unknown) == [([], ""), ([], "")]
