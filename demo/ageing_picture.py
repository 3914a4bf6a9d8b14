"""The picture of the README: what the service says of a fluid that ages, beside the truth."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clutch_model.calibration import nominal_calibration
from clutch_results.curves import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO
from clutch_results.records import Condition, FrictionEstimate, ShiftResult
from demo.drawing import CONDITION_COLOUR, INK, as_svg, drawing_style
from diag_service.service.stages import Diagnosis
from ecu_emulator.truth import ShiftTruth, TruthLog

CLUTCH = 2
BAND_STD = 2.0
MU_C_COLOUR = "#0f6cbd"
MU_S_COLOUR = "#c2410c"
UNKNOWN_COLOUR = "#94a3b0"
LEAST_NAMED = 12  # shifts: a verdict that lasts shorter has no room for its name


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """What was said after one shift of the clutch, and what was true in it."""

    truth: ShiftTruth
    running: FrictionEstimate
    condition: Condition


def points_of(diagnoses: Iterable[Diagnosis | ShiftResult], truth: TruthLog) -> list[Point]:
    """Return what was said after each shift onto the clutch, and what was true in it."""
    true_of = {shift.number: shift for shift in truth.shifts}
    return [
        Point(
            truth=true_of[one.estimate.number],
            running=one.verdict.friction,
            condition=one.verdict.condition,
        )
        for one in diagnoses
        if one.estimate.clutch == CLUTCH and one.verdict.friction is not None
    ]


def draw(shown: Sequence[Point]) -> str:
    """Return the picture as SVG: both coefficients over the shifts, and the verdict below."""
    with drawing_style():
        figure = Figure(figsize=(8.0, 3.8), layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(9.0, 1.0))
        _draw_friction(upper, shown)
        _draw_verdicts(lower, shown)
        return as_svg(figure)


def _draw_friction(axes: Axes, shown: Sequence[Point]) -> None:
    numbers = range(1, len(shown) + 1)
    for name, label, colour in (
        ("mu_c", "friction at high slip, mu_C", MU_C_COLOUR),
        ("mu_s", "friction at low slip, mu_S", MU_S_COLOUR),
    ):
        mean = [getattr(point.running, name) for point in shown]
        std = [getattr(point.running, f"std_{name}") for point in shown]
        low = [value - BAND_STD * one for value, one in zip(mean, std, strict=True)]
        high = [value + BAND_STD * one for value, one in zip(mean, std, strict=True)]
        axes.fill_between(numbers, low, high, color=colour, alpha=0.18, lw=0.0)
        axes.plot(numbers, mean, color=colour, lw=2.0, label=label)
        axes.plot(numbers, [getattr(point.truth, name) for point in shown], color=INK, lw=1.2, ls="--")
    _draw_thresholds(axes)
    axes.plot([], [], color=INK, lw=1.2, ls="--", label="truth")
    axes.fill_between([], [], [], color=UNKNOWN_COLOUR, alpha=0.4, lw=0.0, label="± 2 stated std")
    axes.set_title(f"A fluid that ages: clutch {CLUTCH}, shift by shift")
    axes.legend(loc="lower left", ncols=2)


def _draw_thresholds(axes: Axes) -> None:
    """Draw below which mu_C the verdict is another one, whatever else it goes by."""
    new_mu_c = nominal_calibration().clutches[CLUTCH - 1].friction.mu_c
    # Each where neither curves nor the legend are: mu_C falls through the first from the left, the legend is below it.
    for ratio, condition, side, place, at_points in (
        (WATCH_LEVEL_RATIO, "watch", "left", "bottom", (4.0, 2.0)),
        (CHANGE_LEVEL_RATIO, "change fluid", "right", "top", (-4.0, -3.0)),
    ):
        colour, text = CONDITION_COLOUR[condition], f"mu_C below {100.0 * ratio:.0f} % of new: {condition}"
        axes.axhline(ratio * new_mu_c, color=colour, lw=1.0, ls=(0, (6.0, 3.0)))
        axes.annotate(
            text, (float(side == "right"), ratio * new_mu_c), at_points, axes.get_yaxis_transform(), "offset points",
            color=colour, fontsize=8, ha=side, va=place,
        )  # fmt: skip


def _draw_verdicts(axes: Axes, shown: Sequence[Point]) -> None:
    first = 1
    for condition, same in groupby(shown, key=lambda point: point.condition):
        stop = first + len(list(same))
        label = condition.name.lower().replace("_", " ")
        axes.axvspan(first - 0.5, stop - 0.5, color=CONDITION_COLOUR.get(label, UNKNOWN_COLOUR), lw=0.0)
        if stop - first >= LEAST_NAMED:
            middle = 0.5 * (first + stop - 1)
            axes.text(middle, 0.45, label, ha="center", va="center", fontsize=8, fontweight="bold", color="white")
        first = stop
    axes.set_ylim(0.0, 1.0)
    axes.set_yticks([])
    axes.grid(visible=False)
    axes.set_xlabel(f"shifts onto clutch {CLUTCH}; the bar is the verdict after each of them")
