"""The picture of an analysis: friction of each clutch over its shifts, beside the thresholds of the verdict."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canlog.errors import OutputError
from canlog.extras import load_extra
from clutch_results.curves import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO
from clutch_results.pictures import new_mu_c_of
from clutch_results.records import Condition, ShiftResult, Status
from clutchdiag_io.people import PLUS_MINUS, STDS
from diag_service.delivery.console import condition_words
from fleet_contract import CLUTCHES
from fleet_contract.orders import name_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE_INCH: Final = (9.0, 6.0)
STRIP: Final = (0.0, 0.04)  # of the height: where the verdicts stand
MU_C_COLOUR: Final = "#0f6cbd"
MU_S_COLOUR: Final = "#c2410c"
CONDITION_COLOUR: Final = {
    Condition.NO_VERDICT: "#9ca3af",
    Condition.GOOD: "#15803d",
    Condition.WATCH: "#d97706",
    Condition.CHANGE_FLUID: "#b91c1c",
}


THRESHOLDS: Final = ((WATCH_LEVEL_RATIO, Condition.WATCH), (CHANGE_LEVEL_RATIO, Condition.CHANGE_FLUID))


def draw(results: Sequence[ShiftResult], name: str) -> "Figure":
    """Return the figure, under the name of what was analysed; ExtraMissingError if matplotlib is not installed."""
    load_extra("matplotlib", "plot() needs matplotlib")
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra
    from matplotlib.patches import Patch  # noqa: PLC0415 - likewise

    figure = Figure(figsize=SIZE_INCH, layout="constrained")
    own_names = {one.verdict.clutch: one.verdict.element for one in results if one.verdict.element}
    names = own_names or {clutch: name_of(clutch, None) for clutch in CLUTCHES}
    panels = figure.subplots(len(names), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for (clutch, title), axes in zip(names.items(), panels, strict=True):
        own = [one for one in results if one.estimate.clutch == clutch]
        _draw_clutch(axes, own)
        _draw_thresholds(axes, own)
        axes.set_title(title, loc="left")
        axes.set_ylabel("friction coefficient")
    panels[-1].set_xlabel(f"shift; dots: single shifts, lines: all shifts combined, bars and bands: {PLUS_MINUS}")
    handles = [Patch(color=colour, label=condition_words(condition)) for condition, colour in CONDITION_COLOUR.items()]
    handles += [Patch(color=MU_C_COLOUR, label="mu_C"), Patch(color=MU_S_COLOUR, label="mu_S")]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)
    panels[0].set_title(name, loc="right")
    return figure


def save(figure: "Figure", path: Path) -> None:
    """Write a figure; raises OutputError if the file cannot be written, or its suffix is of no picture."""
    try:
        figure.savefig(path)
    except (OSError, ValueError) as exc:
        reason = exc.strerror if isinstance(exc, OSError) else None
        raise OutputError(f"cannot write {path}: {reason or exc}") from exc


def _draw_clutch(axes: "Axes", results: list[ShiftResult]) -> None:
    for colour, name in ((MU_C_COLOUR, "mu_c"), (MU_S_COLOUR, "mu_s")):
        single = [
            (one.estimate.number, getattr(one.estimate.friction, name), getattr(one.estimate.friction, f"std_{name}"))
            for one in results
            if one.estimate.status is Status.VALID and one.estimate.friction is not None
        ]
        if single:
            numbers, values, stds = zip(*single, strict=True)
            axes.errorbar(
                numbers, values, yerr=[STDS * std for std in stds], fmt="o", ms=3.0, lw=0.8, color=colour, alpha=0.6
            )
        running = [
            (one.estimate.number, getattr(one.verdict.friction, name), getattr(one.verdict.friction, f"std_{name}"))
            for one in results
            if one.verdict.friction is not None
        ]
        if running:
            numbers, values, stds = zip(*running, strict=True)
            low, high = (
                [value + sign * STDS * std for value, std in zip(values, stds, strict=True)] for sign in (-1, 1)
            )
            axes.plot(numbers, values, color=colour, lw=1.6)
            axes.fill_between(numbers, low, high, color=colour, alpha=0.15, lw=0.0)
    for one in results:
        colour = CONDITION_COLOUR[one.verdict.condition]
        axes.axvspan(one.estimate.number - 0.5, one.estimate.number + 0.5, *STRIP, color=colour, lw=0.0)


def _draw_thresholds(axes: "Axes", results: list[ShiftResult]) -> None:
    """Draw below which mu_C the verdict is another one, once a level is known."""
    known = [level for one in results if (level := new_mu_c_of(one.verdict)) is not None]
    if not known:
        return
    for ratio, condition in THRESHOLDS:
        level, colour = ratio * known[-1], CONDITION_COLOUR[condition]
        text = f"mu_C below {100.0 * ratio:.0f} % of new: {condition_words(condition)}"
        axes.axhline(level, color=colour, lw=1.0, ls="--")
        axes.annotate(
            text, (1.0, level), (-4.0, -3.0), axes.get_yaxis_transform(), "offset points",
            color=colour, fontsize=8.0, ha="right", va="top",
        )  # fmt: skip
