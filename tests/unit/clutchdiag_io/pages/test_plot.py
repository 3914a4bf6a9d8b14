"""Plots and cells of pages."""

import re
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from clutchdiag_io.pages.plot import WIDTH, Axis, Plot, thinned

UNIT = Axis(low=0.0, high=1.0, label="x")


def drawn(plot: Plot, style: str) -> str:
    root = ET.fromstring(str(plot.markup()))  # noqa: S314 - our own
    (path,) = [one.get("d") or "" for one in root.iter("path") if one.get("class") == style]
    return path


def points(path: str) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in re.findall(r"[ML]([-\d.]+) ([-\d.]+)", path)]


def test_a_line_goes_through_its_points() -> None:
    plot = Plot("line", UNIT, UNIT, height=310)
    plot.line(np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.5, 1.0]), "line")
    (x0, y0), (x1, y1), (x2, y2) = points(drawn(plot, "line"))
    assert (x0, x2) == (62.0, WIDTH - 24.0)
    assert (y0, y2) == (260.0, 14.0)
    assert (x1, y1) == pytest.approx(((x0 + x2) / 2, (y0 + y2) / 2))


def test_a_line_breaks_where_nothing_is_known() -> None:
    plot = Plot("line", UNIT, UNIT)
    plot.line(np.linspace(0.0, 1.0, 5), np.array([0.0, 1.0, np.nan, 1.0, 0.0]), "line")
    assert drawn(plot, "line").count("M") == 2


@pytest.mark.parametrize(
    ("low", "high"), [(0.0, 1.0), (-3.0, 7.0), (0.1034, 0.1421), (0.0, 12_000.0), (1e-6, 3e-6), (-0.5, -0.4999)]
)
def test_ticks_are_few_round_and_told_apart(low: float, high: float) -> None:
    axis = Axis(low=low, high=high, label="x")
    ticks = axis.ticks
    assert 2 <= len(ticks) <= 13
    assert all(low - 1e-9 * abs(high) <= tick <= high + 1e-9 * abs(high) for tick in ticks)
    texts = [axis.tick_text(tick) for tick in ticks]
    assert len(set(texts)) == len(texts)
    assert [float(text) for text in texts] == pytest.approx(ticks)


def test_of_many_values_the_extremes_of_each_stretch_are_kept() -> None:
    values = np.zeros(10_000)
    values[1234], values[7777] = 5.0, -5.0
    kept = thinned(values, 600)
    assert len(kept) <= 610
    assert {0, 1234, 7777, 9999} <= set(kept.tolist())
    assert (np.diff(kept) > 0).all()
