"""The picture of a demonstration: one shift in its signals, and the friction curves that the shifts revealed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clutch_model.calibration import FrictionCurve, nominal_calibration
from clutch_model.units import bar_from_pa, rpm_from_rad_s
from demo.listener import ClutchState
from demo.outcome import Outcome
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.condition.verdict import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.posterior import curve_band, new_curve

NS_PER_S = 1e9
LegendPlace = Literal["center left", "upper center"]  # where the signals of a shift leave room

BAND_STD = 2.0
SLIP_MAX_RAD_S = 40.0
SLIP_POINTS = 300
SIZE_INCH = (15.0, 8.6)
DOTS_PER_INCH = 110

STYLE = Path(__file__).with_name("picture.mplstyle")
INK, MUTED, GRID = "#22303c", "#6b7a88", "#e3e8ec"
CLUTCH_COLOUR: Mapping[int, str] = MappingProxyType({1: "#c2410c", 2: "#0f6cbd"})
CONDITION_COLOUR: Mapping[str, str] = MappingProxyType(
    {"good": "#15803d", "watch": "#b45309", "change fluid": "#b91c1c"}
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """How one signal is drawn."""

    signal: Signal
    label: str
    colour: str
    is_dashed: bool = False


SPEEDS = (
    Line(signal=Signal.ENGINE_SPEED, label="engine", colour=INK),
    Line(signal=Signal.HUB_SPEED, label="clutch hub", colour="#94a3b0"),
    Line(signal=Signal.INPUT1_SPEED, label="input shaft 1", colour=CLUTCH_COLOUR[1]),
    Line(signal=Signal.INPUT2_SPEED, label="input shaft 2", colour=CLUTCH_COLOUR[2]),
)
PRESSURES = (
    Line(signal=Signal.CLUTCH1_PRESSURE, label="clutch 1", colour=CLUTCH_COLOUR[1]),
    Line(signal=Signal.CLUTCH1_PRESSURE_COMMAND, label="commanded", colour=CLUTCH_COLOUR[1], is_dashed=True),
    Line(signal=Signal.CLUTCH2_PRESSURE, label="clutch 2", colour=CLUTCH_COLOUR[2]),
    Line(signal=Signal.CLUTCH2_PRESSURE_COMMAND, label="commanded", colour=CLUTCH_COLOUR[2], is_dashed=True),
)
TORQUES = (
    Line(signal=Signal.ENGINE_TORQUE, label="engine", colour=INK),
    Line(signal=Signal.CLUTCH1_TORQUE_COMMAND, label="clutch 1, commanded", colour=CLUTCH_COLOUR[1], is_dashed=True),
    Line(signal=Signal.CLUTCH2_TORQUE_COMMAND, label="clutch 2, commanded", colour=CLUTCH_COLOUR[2], is_dashed=True),
)


def draw(path: Path, event: Event, outcome: Outcome) -> None:
    """Write the picture of one shift and of the curves of both clutches as PNG."""
    with style.context(STYLE):
        figure = Figure(figsize=SIZE_INCH, dpi=DOTS_PER_INCH, layout="constrained")
        ((left, right),) = figure.subfigures(1, 2, squeeze=False, width_ratios=(1.1, 1.0), wspace=0.03)
        _draw_shift(left.subplots(3, 1, sharex=True, height_ratios=(1.25, 1.0, 1.0)), event)
        _draw_curves(right.subplots(2, 1, sharex=True, sharey=True), outcome)
        truth = outcome.truth.drive
        figure.suptitle(
            f"Scenario {truth.scenario}, seed {truth.seed}",
            fontsize=14.0,
            fontweight="bold",
            x=0.008,
            ha="left",
        )
        figure.savefig(path)


def _draw_shift(panels: Sequence[Axes], event: Event) -> None:
    gears = f"{event.from_gear}-{event.to_gear}"
    contents: tuple[tuple[tuple[Line, ...], str, LegendPlace], ...] = (
        (SPEEDS, f"Shift {gears} of this drive: speed [rpm]", "center left"),
        (PRESSURES, "Pressure [bar]", "center left"),
        (TORQUES, "Torque [Nm]", "upper center"),
    )
    for axes, (lines, title, place) in zip(panels, contents, strict=True):
        for line in lines:
            if line.signal in event.columns:
                _draw_signal(axes, event, line)
        axes.axvspan(0.0, (event.end_ns - event.start_ns) / NS_PER_S, color=GRID, alpha=0.45, lw=0.0, zorder=0)
        axes.set_title(title)
        axes.legend(loc=place, handlelength=1.6)
    panels[-1].set_xlabel("time since the target gear changed [s]; grey: the shift")


def _draw_signal(axes: Axes, event: Event, line: Line) -> None:
    series = event.columns[line.signal]
    values = series.value
    if line.signal in {drawn.signal for drawn in SPEEDS}:
        values = rpm_from_rad_s(values)
    elif line.signal in {drawn.signal for drawn in PRESSURES}:
        values = bar_from_pa(values)
    axes.plot(
        (series.t_ns - event.start_ns) / NS_PER_S,
        values,
        color=line.colour,
        lw=1.1 if line.is_dashed else 1.6,
        ls=(0, (3.0, 2.0)) if line.is_dashed else "-",
        label=line.label,
    )


def _draw_curves(panels: Sequence[Axes], outcome: Outcome) -> None:
    slip_rad_s = np.linspace(0.0, SLIP_MAX_RAD_S, SLIP_POINTS)
    for clutch, axes in enumerate(panels, start=1):
        reference = nominal_calibration().clutches[clutch - 1].friction
        state = outcome.clutches.get(clutch)
        for result in outcome.shifts:
            if result.estimate.clutch == clutch and result.estimate.friction is not None:
                mean, _ = curve_band(slip_rad_s, result.estimate.friction, reference)
                axes.plot(slip_rad_s, mean, color=CLUTCH_COLOUR[clutch], lw=0.8, alpha=0.35)
        if state is not None and state.friction is not None:
            mean, std = curve_band(slip_rad_s, state.friction, reference)
            axes.fill_between(
                slip_rad_s,
                mean - BAND_STD * std,
                mean + BAND_STD * std,
                color=CLUTCH_COLOUR[clutch],
                alpha=0.18,
                lw=0.0,
                label=f"± {BAND_STD:.0f} std",
            )
            axes.plot(slip_rad_s, mean, color=CLUTCH_COLOUR[clutch], lw=2.4, label="estimate, all shifts")
        true_c, true_s = outcome.true_friction(clutch)
        true = new_curve(slip_rad_s, replace(reference, mu_c=true_c, mu_s=true_s))
        axes.plot(slip_rad_s, true, color=INK, lw=1.6, ls="--", label="truth")
        new = new_curve(slip_rad_s, reference)
        axes.plot(slip_rad_s, new, color=MUTED, lw=1.4, ls=":", label="new fluid")
        _draw_thresholds(axes, reference)
        _title_curve(axes, clutch, state)
        axes.set_ylabel("friction coefficient")
    panels[0].plot([], [], color=MUTED, lw=0.8, alpha=0.6, label="single shifts")
    panels[0].legend(loc="lower left", bbox_to_anchor=(0.0, -0.22), ncols=5, columnspacing=1.2, handlelength=1.8)
    panels[-1].set_xlabel("slip speed [rad/s]")


def _draw_thresholds(axes: Axes, reference: FrictionCurve) -> None:
    """Draw below which level of mu_C, the friction at high slip, the verdict is another one."""
    for ratio, condition in ((WATCH_LEVEL_RATIO, "watch"), (CHANGE_LEVEL_RATIO, "change fluid")):
        level = ratio * reference.mu_c
        axes.axhline(level, color=CONDITION_COLOUR[condition], lw=1.0, ls=(0, (6.0, 3.0)))
        axes.annotate(
            f"mu_C below {ratio:.0%} of new: {condition}",
            (SLIP_MAX_RAD_S, level),
            xytext=(0.0, -2.0),
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=8.0,
            color=CONDITION_COLOUR[condition],
        )


def _title_curve(axes: Axes, clutch: int, state: ClutchState | None) -> None:
    condition = "no verdict" if state is None else state.condition
    axes.set_title(f"Clutch {clutch}: friction over slip")
    axes.set_title(condition, loc="right", color=CONDITION_COLOUR.get(condition, MUTED))
