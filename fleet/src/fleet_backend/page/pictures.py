"""The pictures of the fleet's page: how the fluid of a clutch went and will go, friction over slip, a small curve."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Final

import numpy as np
from markupsafe import Markup

from canlog.arrays import FloatArray
from clutch_model.calibration import FrictionCurve
from clutch_results.curves import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO, WATCH_MARGIN_RATIO
from clutch_results.pictures import THRESHOLD_KEYS, curve_picture
from clutch_results.records import FrictionEstimate
from clutchdiag_io.pages.plot import Axis, Plot, broken, thinned
from clutchdiag_io.people import PLUS_MINUS, STDS
from fleet_backend.page.calibrations import reference_of
from fleet_backend.page.records import ClutchHistory, ReachAnswer, ShiftAnswer, TrendPoint, VehicleAnswer
from fleet_backend.page.wording import M_PER_KM
from fleet_contract.orders import Action, name_of, title_of

_MOST_POINTS: Final = 600  # a screen shows no more
_MOST_MOMENTS: Final = 8  # names of moments do not overlap too much
_AHEAD_RATIO: Final = 1.0  # of the past that is shown: so far the future is
_SPARK_RANGE: Final = (0.7, 1.05)
Keys = tuple[tuple[str, str], ...]  # style and words of what is drawn
Level = tuple[float, str, str]  # where a line lies, its style, its name


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A picture with what its lines stand for."""

    picture: Markup
    caption: str
    keys: Keys


@dataclass(frozen=True, slots=True, kw_only=True)
class PlottedCourse:
    """How what decides the verdict of one clutch went, an item per event; NaN where nothing is known."""

    quantity: str
    single: FloatArray  # (n,) of the event alone
    running: FloatArray  # (n,) of all events so far
    std_running: FloatArray  # (n,)
    levels: tuple[Level, ...]  # new fluid, and the limits of the verdict


def margin_course(points: Sequence[TrendPoint], new: FrictionCurve | None) -> PlottedCourse:
    """Return how the margin against shudder went, which decides most verdicts."""
    mu_c, mu_s = (_column([getattr(one, name) for one in points]) for name in ("mu_c", "mu_s"))
    running_c, running_s = (_column([getattr(one, f"running_{name}") for one in points]) for name in ("mu_c", "mu_s"))
    std_c, std_s = (_column([getattr(one, f"running_std_{name}") for one in points]) for name in ("mu_c", "mu_s"))
    common = _column([one.running_correlation for one in points]) * std_c * std_s
    levels: tuple[Level, ...] = ()
    if new is not None:
        margin, watch = new.mu_c - new.mu_s, f"watch: {100.0 * WATCH_MARGIN_RATIO:.0f} %"
        levels = (margin, "new", "new"), (WATCH_MARGIN_RATIO * margin, "watch", watch), (0.0, "change", "change: 0 %")
    return PlottedCourse(
        quantity="margin mu_C - mu_S",
        single=mu_c - mu_s,
        running=running_c - running_s,
        std_running=np.sqrt(np.maximum(std_c**2 + std_s**2 - 2.0 * common, 0.0)),
        levels=levels,
    )


def level_course(points: Sequence[TrendPoint]) -> PlottedCourse:
    """Return how the friction at high slip went; what new fluid has the results themselves tell."""
    told = [(one.level_ratio, one.running_mu_c) for one in points if one.level_ratio and one.running_mu_c]
    new_mu_c = (told[-1][1] or 0.0) / (told[-1][0] or 1.0) if told else 0.0
    ratios = ((1.0, "new"), (WATCH_LEVEL_RATIO, "watch"), (CHANGE_LEVEL_RATIO, "change"))
    return PlottedCourse(
        quantity="mu_C",
        single=_column([one.mu_c for one in points]),
        running=_column([one.running_mu_c for one in points]),
        std_running=_column([one.running_std_mu_c for one in points]),
        levels=tuple((ratio * new_mu_c, style, f"{style}: {100.0 * ratio:.0f} %") for ratio, style in ratios if told),
    )


def deciding_course(points: Sequence[TrendPoint], new: FrictionCurve | None) -> PlottedCourse:
    """Return the course of what is nearer to its limit."""
    return max(margin_course(points, new), level_course(points), key=_used_ratio)


def _used_ratio(course: PlottedCourse) -> float:
    """Return how much of the way from new fluid to the limit is gone."""
    known = course.running[np.isfinite(course.running)]
    if not len(known) or not course.levels:
        return -np.inf
    new, limit = course.levels[0][0], course.levels[-1][0]
    return float((new - known[-1]) / (new - limit)) if new > limit else -np.inf


def of_vehicle(answer: VehicleAnswer) -> list[Figure]:
    """Return for each clutch how its fluid went and will go."""
    return [_fan(answer, one) for one in answer.clutches if one.trend]


def _fan(answer: VehicleAnswer, clutch: ClutchHistory) -> Figure:
    """Return the past of a clutch with its band, its limits, what happened, and the prognosis as a fan."""
    now, points = clutch.now, clutch.trend
    course = deciding_course(points, reference_of(now.vehicle, now.calibration_version, now.clutch))
    odometer_km = _column([one.odometer_m for one in points]) / M_PER_KM
    has_odometer = 2 * np.count_nonzero(np.isfinite(odometer_km)) > len(points)
    along = _carried_on(odometer_km) if has_odometer else np.arange(1.0, len(points) + 1.0)
    ends = [one.end_at for one in points]
    reach = clutch.outlook.change_fluid if has_odometer and clutch.outlook and course.levels else None
    ahead = np.array([along[-1]]) if reach is None else _ends_km(along, reach)
    wide, style = STDS * course.std_running, f"clutch{now.clutch}"
    marks = np.array([level for level, _, _ in course.levels])
    y = Axis.around(course.quantity, course.single, course.running - wide, course.running + wide, marks)
    label = "odometer [km]" if has_odometer else f"event of {name_of(now.clutch, now.element)}"
    x = Axis.around(label, along, np.minimum(ahead, along[-1] + _span(along)), margin_ratio=0.02)
    title = title_of(now.clutch, now.element)
    plot = Plot(f"{title}: {course.quantity} over distance, single events, estimate with its band, prognosis", x, y)
    for level in course.levels:
        plot.level(*level)
    fills = [_row_after(ends, fill.filled_at) for fill in answer.fills]
    running, where, width = broken(fills, _MOST_POINTS, course.running, along, wide)
    plot.band(where, running - width, running + width, f"band {style}")
    single = thinned(course.single, _MOST_POINTS)
    plot.dots(along[single], course.single[single], style)
    plot.line(where, running, f"line strong {style}")
    last = course.running[np.isfinite(course.running)]
    has_fan = reach is not None and len(last) > 0 and last[-1] > course.levels[-1][0]
    if has_fan:
        low, middle, high = (_fall(x, float(along[-1]), float(last[-1]), end, course.levels[-1][0]) for end in ahead)
        plot.band(low[0], low[1], high[1], f"band {style} ahead")
        plot.line(*middle, f"line dashed {style}")
    for place, kind, text in list(_moments(now.clutch, along, ends, answer))[-_MOST_MOMENTS:]:
        plot.moment(place, kind, text)
    return Figure(
        picture=plot.markup(), caption=f"{title}: {course.quantity}", keys=tuple(_keys(course, style, has_fan=has_fan))
    )


def fluid_bar(answer: VehicleAnswer) -> Markup:
    """Return how far the fluid has gone and how far it will go, as a bar with an interval; empty: that is not known."""
    reaches = [one.outlook.change_fluid for one in answer.clutches if one.outlook and one.outlook.change_fluid]
    known = [one for one in reaches if one.p50_m is not None]
    driven = [one.now.odometer_m for one in answer.clutches if one.now.odometer_m is not None]
    if not known or not driven or answer.action in {Action.CHANGE_NOW, Action.NEW_FLUID, Action.FIND_CAUSE}:
        return Markup()
    first = min(known, key=lambda one: one.p50_m or 0.0)
    filled_m = answer.fills[-1].odometer_m if answer.fills else None
    age_km = 0.0 if filled_m is None else max(max(driven) - filled_m, 0.0) / M_PER_KM
    low, middle, high = (3.0e5 if one is None else one / M_PER_KM for one in (first.p10_m, first.p50_m, first.p90_m))
    low, middle, high = (float(f"{one:.2g}") for one in (low, middle, high))
    age = "" if filled_m is None else f"Fluid: {age_km:,.0f} km old. "
    text = f"{age}Left: {low:,.0f} to {high:,.0f} km (80 % sure), as likely more as less than {middle:,.0f} km."
    text = text if middle > 0.0 else f"{age}Left: at most {high:,.0f} km (90 % sure), probably nothing."
    parts = (("age", 0.0, age_km), ("left", age_km, low), ("fan", age_km + low, high - low))
    whole = max(age_km + high, 1.0)
    boxes = Markup().join(
        Markup('<rect class="{}" x="{:.1f}" y="0" width="{:.1f}" height="20"/>').format(
            style, 1000.0 * start / whole, 1000.0 * width / whole
        )
        for style, start, width in parts
    )
    mark = Markup('<path class="middle" d="M{0:.1f} 0V20"/>').format(1000.0 * (age_km + middle) / whole)
    return Markup(
        '<p class="left">{0}</p><svg class="bar" viewBox="0 0 1000 20" preserveAspectRatio="none" role="img"'
        ' aria-label="{0}">{1}{2}</svg>'
    ).format(text, boxes, mark)


def spark(levels: Sequence[float]) -> Markup:
    """Return a small curve of levels against new fluid, all on one scale; empty where there is none."""
    if len(levels) < 2:
        return Markup()
    places = enumerate(np.clip(levels, *_SPARK_RANGE).tolist())
    step, (low, high) = 100.0 / (len(levels) - 1), _SPARK_RANGE
    line = " ".join(f"{step * place:.1f},{22.0 - 20.0 * (level - low) / (high - low):.1f}" for place, level in places)
    told = f"friction against new: {levels[0]:.0%} to {levels[-1]:.0%}"
    form = '<svg class="spark" viewBox="0 0 100 24" role="img" aria-label="{}"><polyline points="{}"/></svg> '
    return Markup(form).format(told, line)  # noqa: S704 - a form of ours, whose words are escaped


def _span(along: FloatArray) -> float:
    return max(_AHEAD_RATIO * float(along.max() - along.min()), 1.0)


def _ends_km(along: FloatArray, reach: ReachAnswer) -> FloatArray:
    """Return where the limit is passed with 10, 50 and 90 % probability, shape (3,); beyond the horizon far away."""
    distances = (reach.p10_m, reach.p50_m, reach.p90_m)
    return float(along[-1]) + np.array([3.0e5 if one is None else one / M_PER_KM for one in distances])


def _fall(x: Axis, start: float, value: float, end: float, limit: float) -> tuple[FloatArray, FloatArray]:
    """Return a straight way from now to the limit, and along it, up to the end of the picture, shape (n,) each."""
    places = np.linspace(start, max(x.high, start), 50)
    return places, np.interp(places, [start, max(end, start + 1e-6)], [value, limit])


def _keys(course: PlottedCourse, style: str, *, has_fan: bool) -> Iterator[tuple[str, str]]:
    yield f"dots {style}", "single events"
    yield style, "estimate from all events so far"
    yield f"band {style}", PLUS_MINUS
    if has_fan:
        yield f"dashed {style}", "prognosis: half of such fluids reach their limit there, 80 % in the fan"
    if course.levels:
        yield "watch", course.levels[1][2] + " of new fluid"
        yield "change", course.levels[2][2] + " of new fluid"


def _moments(
    clutch: int, along: FloatArray, ends: Sequence[datetime], answer: VehicleAnswer
) -> Iterator[tuple[float, str, str]]:
    """Yield where fluid was filled, and where alarms of the clutch were raised and cleared, in their order."""
    happened = [
        (ends[min(_row_after(ends, fill.filled_at), len(ends) - 1)], "fill", f"new fluid: {fill.product}")
        for fill in answer.fills
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


def of_shift(answer: ShiftAnswer, reference: FrictionCurve) -> list[Figure]:
    """Return the friction over slip by one event alone, and by all events so far."""
    told = ((answer.friction, "this event alone"), (answer.running, "all events so far"))
    return [_curve(answer, reference, values, what) for values, what in told if values is not None]


def _curve(answer: ShiftAnswer, reference: FrictionCurve, values: Mapping[str, float], what: str) -> Figure:
    picture = curve_picture(answer.clutch, FrictionEstimate(**values), reference, answer.element)
    style, limits = f"clutch{answer.clutch}", THRESHOLD_KEYS
    keys = ((style, what), (f"band {style}", PLUS_MINUS), ("new dashed", "new fluid"), *limits)
    title = title_of(answer.clutch, answer.element)
    return Figure(picture=picture, caption=f"{title}: friction over slip, {what}", keys=keys)


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
