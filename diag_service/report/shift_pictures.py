"""Pictures of the signals of one shift."""

from dataclasses import dataclass
from typing import Final

from markupsafe import Markup

from clutch_model.units import NS_PER_S, bar_from_pa, rpm_from_rad_s
from clutchdiag_io.pages.plot import Axis, Plot, thinned
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event

MOST_SAMPLES: Final = 400  # of one signal of a shift


@dataclass(frozen=True, slots=True)
class Curve:
    """One signal of a shift as it is drawn."""

    signal: Signal
    label: str
    style: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """Signals of one unit, drawn together."""

    title: str
    unit: str
    factor: float  # from SI
    curves: tuple[Curve, ...]


PANELS: Final = (
    Panel(
        title="Speeds",
        unit="rpm",
        factor=rpm_from_rad_s(1.0),
        curves=(
            Curve(Signal.ENGINE_SPEED, "engine", "ink"),
            Curve(Signal.HUB_SPEED, "clutch hub", "new"),
            Curve(Signal.INPUT1_SPEED, "input shaft 1", "clutch1"),
            Curve(Signal.INPUT2_SPEED, "input shaft 2", "clutch2"),
            Curve(Signal.INPUT_SPEED, "input shaft", "clutch1"),
            Curve(Signal.TURBINE_SPEED, "turbine", "clutch1"),
        ),
    ),
    Panel(
        title="Pressures",
        unit="bar",
        factor=bar_from_pa(1.0),
        curves=(
            Curve(Signal.CLUTCH1_PRESSURE, "clutch 1", "clutch1"),
            Curve(Signal.LOCKUP_PRESSURE, "lock-up clutch", "clutch1"),
            Curve(Signal.CLUTCH1_PRESSURE_COMMAND, "clutch 1, commanded", "clutch1 dashed"),
            Curve(Signal.CLUTCH2_PRESSURE, "clutch 2", "clutch2"),
            Curve(Signal.CLUTCH2_PRESSURE_COMMAND, "clutch 2, commanded", "clutch2 dashed"),
        ),
    ),
    Panel(
        title="Torques",
        unit="Nm",
        factor=1.0,
        curves=(
            Curve(Signal.ENGINE_TORQUE, "engine", "ink"),
            Curve(Signal.CLUTCH_TORQUE, "clutches", "new"),
            Curve(Signal.CLUTCH1_TORQUE_COMMAND, "clutch 1, commanded", "clutch1 dashed"),
            Curve(Signal.CLUTCH2_TORQUE_COMMAND, "clutch 2, commanded", "clutch2 dashed"),
        ),
    ),
)


def present_curves(panel: Panel, event: Event) -> tuple[Curve, ...]:
    return tuple(one for one in panel.curves if one.signal in event.columns and len(event.columns[one.signal].t_ns))


def shift_picture(panel: Panel, event: Event) -> Markup:
    """Return the signals of one unit over the time of a shift; only for panels of which some are present."""
    curves = present_curves(panel, event)
    times = [(event.columns[one.signal].t_ns - event.start_ns) / NS_PER_S for one in curves]
    values = [event.columns[one.signal].value * panel.factor for one in curves]
    duration_s = (event.end_ns - event.start_ns) / NS_PER_S
    x = Axis.around("time since the shift began [s]; shaded: the shift", *times, margin_ratio=0.0)
    names = ", ".join(one.label for one in curves)
    plot = Plot(f"{panel.title} during the shift [{panel.unit}]: {names}", x, Axis.around(panel.unit, *values))
    plot.span(max(0.0, x.low), min(duration_s, x.high), "shade")
    for one, t_s, value in zip(curves, times, values, strict=True):
        kept = thinned(value, MOST_SAMPLES)
        plot.line(t_s[kept], value[kept], f"line {one.style}")
    return plot.markup()
