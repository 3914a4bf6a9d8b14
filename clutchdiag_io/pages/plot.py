"""A picture with two axes as inline SVG; what it looks like is up to the page's style sheet, light, dark or printed."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import ceil, floor, log10
from typing import Final
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from clutchdiag_io.pages.content import FloatArray

WIDTH, HEIGHT = 720, 310
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 24, 14, 50  # with room for larger letters on a small screen
MARGIN_PX: Final = _LEFT + _RIGHT  # beside what is drawn
_TICK_COUNT: Final = 6
_FARTHEST: Final = 1e150  # of what an axis shows: a span of more is no number
_STEPS: Final = (1.0, 2.0, 5.0, 10.0)
_LINE: Final = 19  # pixels from one line of text to the next, with room for larger letters


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """The range of an axis, and what stands beside it."""

    low: float
    high: float
    label: str

    @classmethod
    def around(cls, label: str, *values: FloatArray | Sequence[float], margin_ratio: float = 0.06) -> "Axis":
        """Return an axis that shows all values, with a margin of its span; something to see even if all are one."""
        finite = np.concatenate([np.asarray(column, np.float64).ravel() for column in values] or [np.empty(0)])
        finite = finite[np.abs(finite) < _FARTHEST]  # nor NaN
        low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
        margin = margin_ratio * (high - low) or max(abs(high) * margin_ratio, 1e-3)
        return cls(low=low - margin, high=high + margin, label=label)

    @property
    def ticks(self) -> list[float]:
        """Round numbers within the range, about half a dozen."""
        rough = (self.high - self.low) / _TICK_COUNT
        power = 10.0 ** floor(log10(rough))
        step = next(factor for factor in _STEPS if factor * power >= rough * (1.0 - 1e-9)) * power
        first, last = ceil(self.low / step - 1e-9), floor(self.high / step + 1e-9)
        return [number * step for number in range(first, last + 1)]

    def tick_text(self, value: float) -> str:
        """Return a tick as text, with as many decimals as tell it from its neighbours."""
        ticks = self.ticks
        step = ticks[1] - ticks[0] if len(ticks) > 1 else 1.0
        decimals = max(0, -floor(log10(step) + 1e-9))
        return f"{value:.{decimals}f}" if decimals or abs(value) < 1e15 else f"{value:g}"


class Plot:
    """One picture, drawn from the back to the front.

    Parameters
    ----------
    label :
        What the picture shows, for those who cannot see it: the table beside it has the numbers.
    """

    def __init__(self, label: str, x: Axis, y: Axis, *, width: int = WIDTH, height: int = HEIGHT) -> None:
        self.x, self.y = x, y
        self._right, self._height = width - _RIGHT, height
        attributes = {"viewBox": f"0 0 {width} {height}", "role": "img", "aria-label": label, "class": "plot"}
        self._svg = Element("svg", attributes)
        self._draw_axes()

    def line(self, x: FloatArray, y: FloatArray, style: str) -> None:
        """Draw a line through points, shape (n,) each; it breaks where ``y`` is NaN."""
        self._path(self._points(x, y), style)

    def band(self, x: FloatArray, low: FloatArray, high: FloatArray, style: str) -> None:
        """Fill what lies between two lines, shape (n,) each, in each stretch where both are known."""
        known = np.isfinite(low) & np.isfinite(high)
        edges = np.flatnonzero(np.diff(known.astype(np.int8), prepend=0, append=0))
        parts = []
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            part = slice(first, last)
            there, back = self._points(x[part], high[part]), self._points(x[part][::-1], low[part][::-1])
            parts.append(f"{there}L{back[1:]}Z")
        self._path("".join(parts), style)

    def level(self, y: float, style: str, text: str, *, is_left: bool = False) -> None:
        """Draw a horizontal line across the picture, with its name at the right end, or at the left one."""
        if not self.y.low <= y <= self.y.high:
            return
        height = _text(self._pixels_y(np.array([y]))[0])
        self._path(f"M{_LEFT} {height}H{self._right}", f"level {style}")
        place = (_LEFT + 4, "begin") if is_left else (self._right - 2, "end")
        self._words(text, place[0], float(height) - 4, f"{place[1]} {style}")

    def moment(self, x: float, style: str, text: str, *, row: int = 0) -> None:
        """Draw a vertical line through the picture, with its name, if any, some lines of text below the upper end."""
        place = self._pixels_x(np.array([x]))[0]
        self._path(f"M{_text(place)} {_TOP}V{self._height - _BOTTOM}", f"moment {style}")
        is_late = place > (self._right + _RIGHT) * 0.75
        side = (-4, "end") if is_late else (4, "begin")
        if text:
            self._words(text, place + side[0], _TOP + 9 + _LINE * row, f"{side[1]} {style}")

    def markup(self) -> Markup:
        """Return the picture as it may stand in a page: every text in it is escaped."""
        return Markup(tostring(self._svg, encoding="unicode"))  # noqa: S704 - ElementTree escapes

    def _draw_axes(self) -> None:
        bottom, right = self._height - _BOTTOM, self._right
        for tick in self.x.ticks:
            place = self._pixels_x(np.array([tick]))[0]
            self._path(f"M{_text(place)} {_TOP}V{bottom}", "grid")
            self._words(self.x.tick_text(tick), place, bottom + 18, "middle")
        for tick in self.y.ticks if self.y.label else ():  # without a name its numbers mean nothing
            place = self._pixels_y(np.array([tick]))[0]
            self._path(f"M{_LEFT} {_text(place)}H{right}", "grid")
            self._words(self.y.tick_text(tick), _LEFT - 6, place + 4, "end tick")
        self._path(f"M{_LEFT} {_TOP}V{bottom}H{right}", "axis")
        self._words(self.x.label, (_LEFT + right) / 2, self._height - 6, "middle name")
        middle = (_TOP + bottom) / 2
        name = self._words(self.y.label, 14, middle, "middle name side")
        name.set("transform", f"rotate(-90 14 {_text(middle)})")

    def _points(self, x: FloatArray, y: FloatArray) -> str:
        """Return a path through the points that are known."""
        known = np.isfinite(x) & np.isfinite(y)
        begins = known & ~np.concatenate(([False], known[:-1]))
        letters = np.where(begins[known], "M", "L").tolist()
        places = zip(letters, _texts(self._pixels_x(x[known])), _texts(self._pixels_y(y[known])), strict=True)
        return "".join(f"{letter}{px} {py}" for letter, px, py in places)

    def _pixels_x(self, x: FloatArray) -> FloatArray:
        share = (np.asarray(x, np.float64) - self.x.low) / (self.x.high - self.x.low)
        return _LEFT + share * (self._right - _LEFT)

    def _pixels_y(self, y: FloatArray) -> FloatArray:
        share = (np.asarray(y, np.float64) - self.y.low) / (self.y.high - self.y.low)
        bottom = self._height - _BOTTOM
        return np.asarray(np.clip(bottom - share * (bottom - _TOP), _TOP, bottom))

    def _path(self, path: str, style: str) -> None:
        if path:
            SubElement(self._svg, "path", {"d": path, "class": style})

    def _words(self, text: str, x: float, y: float, style: str) -> Element:
        element = SubElement(self._svg, "text", {"x": _text(x), "y": _text(y), "class": style})
        element.text = text
        return element


def thinned(values: FloatArray, most: int) -> npt.NDArray[np.int64]:
    """Return which of many values are drawn, at most about ``most``: of each stretch the lowest and the highest.

    Where there are no more than ``most``, all are. Values that are not known count as neither.
    """
    if len(values) <= most:
        return np.arange(len(values))
    bounds = np.linspace(0, len(values), most // 2 + 1).astype(np.int64)
    rows: set[int] = {0, len(values) - 1}
    for first, last in itertools.pairwise(bounds):
        part = values[first:last]
        if np.isfinite(part).any():
            rows |= {int(first + np.nanargmin(part)), int(first + np.nanargmax(part))}
    return np.array(sorted(rows))


def broken(starts: Iterable[int], most: int, values: FloatArray, *others: FloatArray) -> list[FloatArray]:
    """Return columns, shape (n,) each, thinned by ``values``, with NaN before each row of ``starts``.

    No line joins what is on both sides of such a row.
    """
    bounds = sorted({0, len(values), *starts})
    rows = [first + thinned(values[first:last], most) for first, last in itertools.pairwise(bounds)]
    return [
        np.concatenate([np.append(column[row], np.nan) for row in rows] or [column]) for column in (values, *others)
    ]


def _text(pixels: float) -> str:
    return f"{pixels:.1f}".removesuffix(".0")


def _texts(pixels: FloatArray) -> list[str]:
    return [_text(place) for place in np.rint(pixels * 10.0) / 10.0]
