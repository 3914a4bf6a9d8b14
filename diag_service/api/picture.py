"""The picture of an analysis: the fan chart of its report, drawn by matplotlib."""

from pathlib import Path
from typing import TYPE_CHECKING, Final

from canlog.errors import OutputError
from canlog.extras import load_extra
from clutch_results.pictures import LIMITS, MOMENT_ROWS, Fan
from clutchdiag_io.people import PLUS_MINUS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZE_INCH: Final = (9.0, 4.5)
CLUTCH_COLOUR: Final = {1: "#b83a0a", 2: "#0b5cab"}
KIND_COLOUR: Final = {"watch": "#8f4a00", "change": "#a81c1c", "change_fluid": "#a81c1c"}  # of limits and moments
INK: Final = "#22303c"
MUTED: Final = "#526170"
ZONE_OPACITY: Final = 0.1
BAND_OPACITY: Final = 0.2


def draw(fan: Fan | None, name: str) -> "Figure":
    """Return the figure, under the name of what was analysed; ExtraMissingError if matplotlib is not installed."""
    load_extra("matplotlib", "plot() needs matplotlib")
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra

    figure = Figure(figsize=SIZE_INCH, layout="constrained")
    axes = figure.subplots()
    axes.set_title(name, loc="right")
    axes.set_ylabel("friction margin [%], 100: new fluid")
    if fan is None:
        axes.set_title("no friction is known", loc="left")
        return figure
    first = fan.pasts[0]
    for past in reversed(fan.pasts):
        along, left, wide, _ = fan.drawn(past)
        colour = CLUTCH_COLOUR[past.clutch]
        axes.plot(along, left, color=colour, lw=2.2 if past is first else 1.2, label=past.title)
        if past is first:
            axes.fill_between(
                along, left - wide, left + wide, color=colour, alpha=BAND_OPACITY, lw=0.0, label=PLUS_MINUS
            )
    bottom, top = min(-12.0, axes.get_ylim()[0]), max(112.0, axes.get_ylim()[1])
    if len(fan.ahead):
        low, middle, high = fan.quantiles
        axes.fill_between(
            fan.ahead, low, high, color=INK, alpha=BAND_OPACITY, lw=0.0, label="forecast: 8 of 10 courses"
        )
        axes.plot(fan.ahead, middle, color=INK, lw=1.2, ls="--", label="its middle")
    for (limit, kind, text), base in zip(LIMITS, (0.0, bottom), strict=True):
        axes.axhspan(base, limit, color=KIND_COLOUR[kind], alpha=ZONE_OPACITY, lw=0.0)
        axes.axhline(limit, color=KIND_COLOUR[kind], lw=1.0, ls="--")
        axes.annotate(
            text, (0.0, limit), (4.0, 3.0), axes.get_yaxis_transform(), "offset points", color=KIND_COLOUR[kind]
        )
    for turn, (place, kind, text) in enumerate(fan.moments):
        colour, at = KIND_COLOUR.get(kind, MUTED), (3.0, -12.0 - 11.0 * (turn % MOMENT_ROWS))
        axes.axvline(place, color=colour, lw=1.0, ls="--")
        axes.annotate(text, (place, 1.0), at, axes.get_xaxis_transform(), "offset points", color=colour, fontsize=8.0)
    axes.set_ylim(bottom, top)
    axes.set_xlabel(fan.label)
    figure.legend(loc="outside upper left", ncols=5, frameon=False, fontsize=8.0)
    return figure


def save(figure: "Figure", path: Path) -> None:
    """Write a figure; raises OutputError if the file cannot be written, or its suffix is of no picture."""
    try:
        figure.savefig(path)
    except (OSError, ValueError) as exc:
        reason = exc.strerror if isinstance(exc, OSError) else None
        raise OutputError(f"cannot write {path}: {reason or exc}") from exc
