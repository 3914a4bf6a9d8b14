"""The pictures of the fleet's page: how a clutch went, with the bands of its estimate, fluids and alarms."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

import numpy as np
from markupsafe import Markup

from canlog.arrays import FloatArray
from clutch_model.calibration import FrictionCurve
from clutch_results.curves import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO, WATCH_MARGIN_RATIO
from clutch_results.pictures import MOST_MOMENTS, MOST_POINTS, THRESHOLD_KEYS
from clutch_results.shift_course import COURSE_COUNT
from clutchdiag_io.pages.content import Key
from clutchdiag_io.pages.plot import Axis, Plot, broken, thinned
from clutchdiag_io.people import PLUS_MINUS, STDS
from fleet_backend.page.calibrations import reference_of
from fleet_backend.page.records import ClutchNow, TrendPoint, Usual, VehicleAnswer
from fleet_backend.page.wording import M_PER_KM
from fleet_contract.orders import name_of, title_of

Level = tuple[float, str, str]  # where a line lies, its style, its name


class Quantity(StrEnum):
    """What is drawn of a clutch; the margin decides most verdicts."""

    MARGIN = "margin mu_C - mu_S"
    MU_C = "mu_C"
    MU_S = "mu_S"
    SCORE = "score"  # of gear changes, 100 is faultless

    @property
    def form(self) -> str:
        """How its numbers are written."""
        return "{:.1f}" if self is Quantity.SCORE else "{:.4f}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """How one quantity of one clutch went, an item per event; NaN where nothing is known."""

    clutch: int
    title: str  # what the clutch is called
    quantity: Quantity
    along: FloatArray  # (n,) kilometres, or numbers of the events
    label: str  # of the horizontal axis
    single: FloatArray  # (n,) of the event alone
    running: FloatArray  # (n,) of all events so far
    std_running: FloatArray  # (n,)
    levels: tuple[Level, ...]  # of new fluid, and thresholds of the verdict
    moments: tuple[tuple[float, str, str], ...]  # place on the axis, style, text
    fills: tuple[int, ...] = ()  # rows of the first events with another fluid
    usual: Usual | None = None  # in the fleet now

    @classmethod
    def of(
        cls,
        now: ClutchNow,
        quantity: Quantity,
        points: Sequence[TrendPoint],
        answer: VehicleAnswer,
        usual: Usual | None,
    ) -> "Course":
        """Return the course of a clutch, over the odometer if most events know it."""
        odometer_km = _column([one.odometer_m for one in points]) / M_PER_KM
        has_odometer = 2 * np.count_nonzero(np.isfinite(odometer_km)) > len(points)
        along = _carried_on(odometer_km) if has_odometer else np.arange(1.0, len(points) + 1.0)
        single, running, std_running = _values(quantity, points)
        ends = [one.end_at for one in points]
        return cls(
            clutch=now.clutch,
            title=title_of(now.clutch, now.element),
            quantity=quantity,
            along=along,
            label="odometer [km]" if has_odometer else f"event of {name_of(now.clutch, now.element)}",
            single=single,
            running=running,
            std_running=std_running,
            levels=_levels(quantity, points, reference_of(now.vehicle, now.calibration_version, now.clutch)),
            moments=tuple(_moments(now.clutch, along, ends, answer))[-MOST_MOMENTS:],
            fills=tuple(_row_after(ends, fill.filled_at) for fill in answer.fills),
            usual=usual if quantity is Quantity.MU_C else None,
        )


def _values(quantity: Quantity, points: Sequence[TrendPoint]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what each event said alone, what was known after it, and the deviation of that; shape (n,) each."""
    if quantity is Quantity.SCORE:
        return _scores([one.score for one in points])
    mu_c, mu_s = _column([one.mu_c for one in points]), _column([one.mu_s for one in points])
    running_c, std_c = (_column([getattr(one, f"running_{name}mu_c") for one in points]) for name in ("", "std_"))
    running_s, std_s = (_column([getattr(one, f"running_{name}mu_s") for one in points]) for name in ("", "std_"))
    if quantity is Quantity.MU_C:
        return mu_c, running_c, std_c
    if quantity is Quantity.MU_S:
        return mu_s, running_s, std_s
    common = _column([one.running_correlation for one in points]) * std_c * std_s
    return mu_c - mu_s, running_c - running_s, np.sqrt(np.maximum(std_c**2 + std_s**2 - 2.0 * common, 0.0))


def _scores(told: Sequence[float | None]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return scores, their mean over the last twenty, and how well that is known; shape (n,) each."""
    single = _column(told)
    known = np.flatnonzero(np.isfinite(single))
    running, std = np.full((2, len(single)), np.nan)
    for place, row in enumerate(known.tolist()):
        last = single[known[max(place + 1 - COURSE_COUNT, 0) : place + 1]]
        running[row], std[row] = last.mean(), last.std() / np.sqrt(len(last))
    return single, _carried_on(running), _carried_on(std)


def _levels(quantity: Quantity, points: Sequence[TrendPoint], new: FrictionCurve | None) -> tuple[Level, ...]:
    """Return new fluid and the thresholds, as far as they are known; that of mu_C the results themselves tell."""
    if quantity is Quantity.MU_C:
        told = [one for one in points if one.level_ratio and one.running_mu_c]
        if not told:
            return ()
        new_mu_c = (told[-1].running_mu_c or 0.0) / (told[-1].level_ratio or 1.0)
        ratios = ((1.0, "new"), (WATCH_LEVEL_RATIO, "watch"), (CHANGE_LEVEL_RATIO, "change"))
        return tuple((ratio * new_mu_c, style, f"{style}: {100.0 * ratio:.0f} %") for ratio, style in ratios)
    if new is None or quantity is Quantity.SCORE:
        return ()
    if quantity is Quantity.MU_S:
        return ((new.mu_s, "new", "new"),)
    margin = new.mu_c - new.mu_s
    watch = (WATCH_MARGIN_RATIO * margin, "watch", f"watch: {100.0 * WATCH_MARGIN_RATIO:.0f} %")
    return (margin, "new", "new"), watch, (0.0, "change", "change: 0 %")


def course_picture(course: Course) -> Markup:
    """Return how a quantity of a clutch went, thinned to what a screen can show."""
    wide = STDS * course.std_running
    usual = [] if course.usual is None else [course.usual.low_mu_c, course.usual.high_mu_c]
    marks = np.array([*(y for y, _, _ in course.levels), *usual])
    y = Axis.around(course.quantity, course.single, course.running - wide, course.running + wide, marks)
    x = Axis.around(course.label, course.along, np.array([place for place, _, _ in course.moments]), margin_ratio=0.02)
    what = f"trend of {course.quantity}, single events, running estimate with its band"
    plot = Plot(f"{course.title}: {what}", x, y)
    if usual:
        plot.band(np.array([x.low, x.high]), np.full(2, usual[0]), np.full(2, usual[1]), "shade")
    for level in course.levels:
        plot.level(*level)
    single = thinned(course.single, MOST_POINTS)
    running, along, width = broken(course.fills, MOST_POINTS, course.running, course.along, wide)
    plot.band(along, running - width, running + width, f"band clutch{course.clutch}")
    plot.dots(course.along[single], course.single[single], f"clutch{course.clutch}")
    plot.line(along, running, f"line strong clutch{course.clutch}")
    for place, style, text in course.moments:
        plot.moment(place, style, text)
    return plot.markup()


def course_keys(course: Course) -> tuple[Key, ...]:
    """Return what the lines of a course stand for."""
    clutch = course.clutch
    is_score = course.quantity is Quantity.SCORE
    so_far = f"mean of the last {COURSE_COUNT}" if is_score else "estimate from all events so far"
    usual = Key(style="shade", text="80 % of the clutches of this type and fluid are in this range now")
    thresholds = {
        Quantity.MU_C: THRESHOLD_KEYS,
        Quantity.MU_S: (),
        Quantity.SCORE: (),
        Quantity.MARGIN: (
            Key(style="watch", text=f"watch below {100.0 * WATCH_MARGIN_RATIO:.0f} % of new"),
            Key(style="change", text="change below 0: the clutch can shudder"),
        ),
    }
    return (
        Key(style=f"dots clutch{clutch}", text="single events"),
        Key(style=f"clutch{clutch}", text=so_far),
        Key(style=f"band clutch{clutch}", text=PLUS_MINUS),
        *(() if course.usual is None else (usual,)),
        *(thresholds[course.quantity] if course.levels else ()),
    )


def _column(values: Sequence[float | None]) -> FloatArray:
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _carried_on(odometer_km: FloatArray) -> FloatArray:
    """Return readings with the last known one where there is none; before the first that one."""
    known = np.flatnonzero(np.isfinite(odometer_km))
    place = np.clip(np.searchsorted(known, np.arange(len(odometer_km)), side="right") - 1, 0, None)
    return np.asarray(odometer_km[known[place]])


def _row_after(ends: Sequence[datetime], filled_at: datetime) -> int:
    """Return the row of the first event with a fluid; behind the last row where there is none yet."""
    return next((row for row, end in enumerate(ends) if end > filled_at), len(ends))


def _moments(
    clutch: int, along: FloatArray, ends: Sequence[datetime], answer: VehicleAnswer
) -> Iterator[tuple[float, str, str]]:
    """Yield where fluid was filled, and where alarms of the clutch were raised and cleared, in their order."""
    happened = [
        (ends[min(_row_after(ends, fill.filled_at), len(ends) - 1)], "fill", f"new fluid: {fill.product}")
        for fill in answer.fills
        if ends
    ]
    for alarm in answer.alarms:
        if alarm.clutch == clutch and alarm.rule == "verdict":
            happened.append((alarm.raised_at, "change_fluid", "alarm"))
            if alarm.cleared_at is not None:
                happened.append((alarm.cleared_at, "good", "alarm over"))
    for at, style, text in sorted(happened):
        place = next((row for row, end in enumerate(ends) if end >= at), None)
        if place is not None:
            yield float(along[place]), style, text
