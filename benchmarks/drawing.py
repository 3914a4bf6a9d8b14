"""Pictures for the documents: the same bytes for the same numbers."""

from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO

import matplotlib as mpl
from matplotlib import style
from matplotlib.figure import Figure

from demo.picture import STYLE

HASH_SALT = "clutchdiag"


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
