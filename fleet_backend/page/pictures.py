"""The pictures of the fleet's page: how a clutch went, with the bands of its estimate, fluids and alarms."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Final

import numpy as np
from markupsafe import Markup

from canlog.arrays import FloatArray
from clutchdiag_io.pages.content import Key
from clutchdiag_io.pages.plot import Axis, Plot, thinned
from diag_service.diagnosis.condition.verdict import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO
from diag_service.report.pictures import MOST_MOMENTS, MOST_POINTS, THRESHOLD_KEYS
from fleet_backend.page.records import ClutchAlarm, Fill, TrendPoint, Usual
from fleet_backend.page.wording import M_PER_KM

STD_OF_50_PERCENT: Final = 0.6744897501960817  # of a normal distribution
STD_OF_90_PERCENT: Final = 1.6448536269514722
THRESHOLDS: Final = ((1.0, "new"), (WATCH_LEVEL_RATIO, "watch"), (CHANGE_LEVEL_RATIO, "change"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """How the friction of one clutch went, an item per event; NaN where nothing is known."""

    clutch: int
    along: FloatArray  # (n,) kilometres, or numbers of the events
    label: str  # of the horizontal axis
    single: FloatArray  # (n,) of the event alone
    running: FloatArray  # (n,) of all events so far
    std_running: FloatArray  # (n,)
    new_mu_c: float | None
    moments: tuple[tuple[float, str, str], ...]  # place on the axis, style, text
    usual: Usual | None = None  # in the fleet now

    @classmethod
    def of(
        cls,
        clutch: int,
        points: Sequence[TrendPoint],
        fills: Sequence[Fill],
        alarms: Sequence[ClutchAlarm],
        usual: Usual | None,
    ) -> "Course":
        """Return the course of a clutch, over the odometer if most events know it."""
        odometer_km = _column([one.odometer_m for one in points]) / M_PER_KM
        has_odometer = 2 * np.count_nonzero(np.isfinite(odometer_km)) > len(points)
        along = _carried_on(odometer_km) if has_odometer else np.arange(1.0, len(points) + 1.0)
        levels = [one for one in points if one.level_ratio and one.running_mu_c]
        new_mu_c = (levels[-1].running_mu_c or 0.0) / (levels[-1].level_ratio or 1.0) if levels else None
        ends = [one.end_at for one in points]
        return cls(
            clutch=clutch,
            along=along,
            label="odometer [km]" if has_odometer else f"event of clutch {clutch}",
            single=_column([one.mu_c for one in points]),
            running=_column([one.running_mu_c for one in points]),
            std_running=_column([one.running_std_mu_c for one in points]),
            new_mu_c=new_mu_c,
            moments=tuple(_moments(clutch, along, ends, fills, alarms))[-MOST_MOMENTS:],
            usual=usual,
        )


def course_picture(course: Course) -> Markup:
    """Return how the friction of a clutch went, thinned to what a screen can show."""
    half, wide = STD_OF_50_PERCENT * course.std_running, STD_OF_90_PERCENT * course.std_running
    levels = [] if course.new_mu_c is None else [ratio * course.new_mu_c for ratio, _ in THRESHOLDS]
    usual = [] if course.usual is None else [course.usual.low_mu_c, course.usual.high_mu_c]
    y = Axis.around("mu_C", course.single, course.running - wide, course.running + wide, np.array([*levels, *usual]))
    x = Axis.around(course.label, course.along, np.array([place for place, _, _ in course.moments]), margin_ratio=0.02)
    label = f"Clutch {course.clutch}: trend of mu_C, single events, running estimate with bands of 50 and 90 percent"
    plot = Plot(label, x, y)
    if usual:
        plot.band(np.array([x.low, x.high]), np.full(2, usual[0]), np.full(2, usual[1]), "shade")
    if course.new_mu_c is not None:
        for ratio, style in THRESHOLDS:
            plot.level(ratio * course.new_mu_c, style, f"{style}: {100.0 * ratio:.0f} %")
    single, running = thinned(course.single, MOST_POINTS), thinned(course.running, MOST_POINTS)
    for width in (wide, half):
        low, high = (course.running - width)[running], (course.running + width)[running]
        plot.band(course.along[running], low, high, f"band clutch{course.clutch}")
    plot.dots(course.along[single], course.single[single], f"clutch{course.clutch}")
    plot.line(course.along[running], course.running[running], f"line strong clutch{course.clutch}")
    for place, style, text in course.moments:
        plot.moment(place, style, text)
    return plot.markup()


def course_keys(course: Course) -> tuple[Key, ...]:
    """Return what the lines of a course stand for."""
    clutch = course.clutch
    usual = Key(style="shade", text="80 % of the clutches of this type and fluid are in this range now")
    return (
        Key(style=f"dots clutch{clutch}", text="single events"),
        Key(style=f"clutch{clutch}", text="estimate from all events so far"),
        Key(style=f"band clutch{clutch}", text="likely range: 50 % (dark) and 90 %"),
        *(() if course.usual is None else (usual,)),
        *THRESHOLD_KEYS,
    )


def _column(values: Sequence[float | None]) -> FloatArray:
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _carried_on(odometer_km: FloatArray) -> FloatArray:
    """Return readings with the last known one where there is none; before the first that one."""
    known = np.flatnonzero(np.isfinite(odometer_km))
    place = np.clip(np.searchsorted(known, np.arange(len(odometer_km)), side="right") - 1, 0, None)
    return np.asarray(odometer_km[known[place]])


def _moments(
    clutch: int, along: FloatArray, ends: Sequence[datetime], fills: Sequence[Fill], alarms: Sequence[ClutchAlarm]
) -> Iterator[tuple[float, str, str]]:
    """Yield where fluid was filled, and where alarms of the clutch were raised and cleared, in their order."""
    happened = [(fill.filled_at, "fill", f"new fluid: {fill.product}") for fill in fills]
    for alarm in alarms:
        if alarm.clutch == clutch:
            happened.append((alarm.raised_at, "change_fluid", "alarm"))
            if alarm.cleared_at is not None:
                happened.append((alarm.cleared_at, "good", "alarm over"))
    for at, style, text in sorted(happened):
        place = next((row for row, end in enumerate(ends) if end >= at), None)
        if place is not None:
            yield float(along[place]), style, text
