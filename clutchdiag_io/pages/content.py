"""What pages have in common: numbers for people and programs, and their templates."""

from collections.abc import Sequence
from math import isfinite
from typing import Final

import numpy as np
import numpy.typing as npt
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from clutchdiag_io.people import digits

FloatArray = npt.NDArray[np.float64]
NONE: Final = "–"


def number(value: float | None, form: str = "{:.4f}", scale: float = 1.0) -> Markup | str:
    """Return a number as people read it, times a scale, and all digits for programs; a dash where there is none.

    Without a form it has the digits that tell something.
    """
    if value is None or not isfinite(value):
        return NONE
    text = form.format(value * scale) if form else digits(value * scale)
    text = text.replace("%", " %").replace("100.0 %", "100 %")
    text = text if any(digit in text for digit in "123456789") else text.lstrip("-")
    return Markup(f'<data value="{float(value)}">{text}</data>')  # noqa: S704 - of a number alone; a page has hundreds


def spread(values: FloatArray | Sequence[object], most: int) -> list[int]:
    """Return at most ``most`` places of a sequence, evenly spread, the first and the last among them."""
    count = len(values)
    return sorted(set(np.linspace(0, count - 1, min(count, most)).round().astype(int).tolist())) if count else []


_OWN: Final = "clutchdiag_io.pages"  # brings plot.css and parts.html


def templates_of(package: str) -> Environment:
    """Return the templates of a package's folder ``templates``, and behind them those that all pages share."""
    made = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader(_OWN)]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["number"] = number
    return made
