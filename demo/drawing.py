"""Pictures for the documents: the same bytes for the same numbers."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from types import MappingProxyType
from typing import Final

import matplotlib as mpl
from matplotlib import style
from matplotlib.figure import Figure

HASH_SALT = "clutchdiag"
STYLE: Final = Path(__file__).with_name("picture.mplstyle")
INK, MUTED, GRID = "#22303c", "#6b7a88", "#e3e8ec"
CLUTCH_COLOUR: Final[Mapping[int, str]] = MappingProxyType({1: "#c2410c", 2: "#0f6cbd"})
CONDITION_COLOUR: Final[Mapping[str, str]] = MappingProxyType(
    {"good": "#15803d", "watch": "#b45309", "change fluid": "#b91c1c"}
)


@contextmanager
def drawing_style() -> Iterator[None]:
    """Draw in the style of the project, texts as texts."""
    with style.context(STYLE), mpl.rc_context({"svg.hashsalt": HASH_SALT, "svg.fonttype": "none"}):
        yield


def as_svg(figure: Figure) -> str:
    """Return a figure as SVG without a date; to be called within `drawing_style`."""
    stream = StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None})
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"
