"""Pictures and tables of a clutch: friction over slip, the margin that is left of it, causes and loads."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final

import numpy as np
from markupsafe import Markup

from canlog.arrays import FloatArray
from clutch_model.calibration import FrictionCurve
from clutch_model.units import NS_PER_S, rad_s_from_rpm, rpm_from_rad_s
from clutch_results.curves import (
    CALIBRATED_RATIO,
    CHANGE_LEVEL_RATIO,
    WATCH_LEVEL_RATIO,
    WATCH_MARGIN_RATIO,
    curve_band,
    margin_left,
    new_curve,
)
from clutch_results.event_kinds import DATED_NS, GEAR_CHANGES
from clutch_results.measures import Measure
from clutch_results.prognosis import Prognosis, forecast
from clutch_results.prognosis.history import UNSEEN_M
from clutch_results.prognosis.prognosis import M_PER_KM
from clutch_results.prognosis.sentence import soonest
from clutch_results.records import Condition, FluidFill, FrictionEstimate, ShiftResult, utc_from_bus_ns
from clutch_results.shifting import drives_of, shifting_of
from clutchdiag_io.pages.plot import HEIGHT, MARGIN_PX, WIDTH, Axis, Plot, broken, thinned
from clutchdiag_io.people import STDS
from fleet_contract.orders import Action, title_of

MOST_POINTS: Final = 600  # of a trend; a screen shows no more
MOST_MOMENTS: Final = 8  # the last ones
_SLIP_RAD_S: Final = rad_s_from_rpm(np.linspace(0.0, 400.0, 121))
THRESHOLD_KEYS: Final = (  # style and text
    ("watch", f"watch below {100.0 * WATCH_LEVEL_RATIO:.0f} % of new"),
    ("change", f"change below {100.0 * CHANGE_LEVEL_RATIO:.0f} % of new"),
)
_THRESHOLDS: Final = ((1.0, "new"), (WATCH_LEVEL_RATIO, "watch"), (CHANGE_LEVEL_RATIO, "change"))
WATCH_PERCENT: Final = 100.0 * WATCH_MARGIN_RATIO  # of the margin
LIMITS: Final = ((WATCH_PERCENT, "watch", f"watch: {WATCH_PERCENT:.0f} %"), (0.0, "change", "change: 0 %"))
LEAST_KM: Final = 20.0  # on fewer kilometres events are told apart by their numbers
MOST_AHEAD_M: Final = 1.575e8  # no fan goes farther
SHOWN_PERCENT: Final = (-120.0, 160.0)  # a margin that is little known may be anywhere
FAN_SIZE: Final = (640, 280)
UNFORETOLD: Final = (Action.CHANGE_NOW, Action.FIND_CAUSE, Action.NEW_FLUID)
MARK_ROWS: Final = 5  # in which names of moments stand; what has no room in them is a line without a name
LETTER: Final = 17.0  # pixels of a picture of full width, where a small screen draws it small
MARK_GAP: Final = 12.0  # pixels between a line and the next name
SECONDS_A_DAY: Final = 86_400.0
LATE_SHARE: Final = 0.75  # of the axis: behind it names stand before their lines, as `Plot.moment` sets them


@dataclass(frozen=True, slots=True, kw_only=True)
class Past:
    """What was left of the friction margin of one clutch [%], an item per event that engaged it; NaN while unknown."""

    clutch: int
    title: str  # name of the clutch
    along: FloatArray  # (n,) places on the axis
    left: FloatArray  # (n,)
    std: FloatArray  # (n,)
    events: tuple[tuple[str, int], ...]  # stream and position of each
    drawn: tuple[FloatArray, ...] = ()  # thinned, gaps at new fluid: places, margins, two deviations, numbers of events


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """A moment as it is drawn: a line, and its name in a row where it covers no other; None: it has no name."""

    place: float  # on the axis
    kind: str
    text: str
    row: int | None
    ends: tuple[float, float]  # of the name, on the axis


@dataclass(frozen=True, slots=True, kw_only=True)
class Fan:
    """The friction margin of a vehicle over its kilometres, and what is foretold of the clutch that decides."""

    pasts: tuple[Past, ...]  # the one that decides first
    label: str  # of the horizontal axis
    moments: tuple[tuple[float, str, str], ...]  # place on the axis, kind, text
    ahead: FloatArray  # (d,) places on the axis from today on; empty: nothing is foretold
    quantiles: FloatArray  # (3, d) less than this is left with 10, 50 and 90 % probability [%]

    @property
    def axes(self) -> tuple[Axis, Axis]:
        """The axes on which all of it has room."""
        edges = [left + sign * wide for _, left, wide, _ in (past.drawn for past in self.pasts) for sign in (-1.0, 1.0)]
        shown = [np.clip(edge, *SHOWN_PERCENT) for edge in edges]
        y = Axis.around("friction margin [%]", [-12.0, 112.0], *shown, margin_ratio=0.0)
        return Axis.around(self.label, *(past.along for past in self.pasts), self.ahead, margin_ratio=0.02), y

    @property
    def marks(self) -> tuple[Mark, ...]:
        """The moments and today, each once, with names that do not overprint each other."""
        today = [(float(self.ahead[0]), "today", "today")] if len(self.ahead) else []
        x, marks = self.axes[0], list[Mark]()
        pixel = (x.high - x.low) / (FAN_SIZE[0] - MARGIN_PX)
        for place, kind, text in dict.fromkeys((*today, *self.moments)):  # today has a name whatever else has none
            width, is_late = (LETTER * len(text) + MARK_GAP) * pixel, place > x.low + LATE_SHARE * (x.high - x.low)
            ends = (place - width, place) if is_late else (place, place + width)
            near = [
                mark for mark in marks if mark.row is not None and mark.ends[0] < ends[1] and ends[0] < mark.ends[1]
            ]
            free = (row for row in range(MARK_ROWS) if all(mark.row != row for mark in near))
            row = None if any(mark.text == text for mark in near) else next(free, None)
            marks.append(Mark(place=place, kind=kind, text=text, row=row, ends=ends))
        return tuple(marks)


def fan_of(
    results: Sequence[ShiftResult],
    fills: Sequence[FluidFill],
    new_friction: Sequence[FrictionCurve],
    prognoses: Sequence[Prognosis] = (),
    *,
    is_foretold: bool = False,
    alarms: Sequence[tuple[str, str]] = (),
) -> Fan | None:
    """Return the fan of results in their order, all of one calibration; None where no margin is known.

    ``new_friction`` is that of each clutch with new fluid; if it ``is_foretold``, the fan of the clutch that decides
    goes on by its prognosis; ``alarms`` are moments (ISO 8601 UTC) and texts.
    """
    curves = dict(enumerate(new_friction, 1))
    reach = soonest(prognoses)
    soon = [prognosis.clutch for prognosis in prognoses if reach is not None and prognosis.change_fluid is reach]
    pasts = [past for clutch, new in curves.items() if len((past := _past(clutch, results, new)).left)]
    if not pasts:
        return None
    pasts.sort(key=lambda past: (past.clutch not in soon, past.left[-1]))
    first = pasts[0].clutch
    decisive = next((prognosis for prognosis in prognoses if prognosis.clutch == first), None)
    foretold = None if decisive is None or not is_foretold else forecast(decisive, MOST_AHEAD_M)
    km, ahead, quantiles = _odometer_km(results), np.empty(0), np.empty((3, 0))
    if foretold is not None:
        _, likely_m, sure_m = (np.interp(0.0, -left, foretold.distance_m) for left in foretold.quantiles)
        is_shown = foretold.distance_m <= 1.05 * min(sure_m, 2.0 * likely_m)
        ahead, quantiles = km[-1] + foretold.distance_m[is_shown] / M_PER_KM, 100.0 * foretold.quantiles[:, is_shown]
    has_km = foretold is not None or np.ptp(km) >= LEAST_KM  # NaN where the odometer is not known
    along = km if has_km else np.arange(1.0, len(results) + 1.0)
    moments = _moments(first, results, along, fills, alarms)
    new_fluids = [place for place, kind, _ in moments if kind == "fill"]
    return Fan(
        pasts=tuple(_thinned(past, along[past.along.astype(np.int64)], new_fluids) for past in pasts),
        label="odometer [km]" if has_km else "event",
        moments=tuple(moments),
        ahead=ahead,
        quantiles=quantiles,
    )


def _past(clutch: int, results: Sequence[ShiftResult], new: FrictionCurve) -> Past:
    """Return the past of a clutch over the places of its results; empty while its margin is not known."""
    places = [place for place, result in enumerate(results) if result.estimate.clutch == clutch]
    margins = np.array([margin_left(results[place].verdict, new) for place in places], np.float64).reshape(-1, 2)
    if not np.isfinite(margins[-1:]).any():
        places, margins = [], margins[:0]
    title = title_of(clutch, results[places[-1]].verdict.element if places else None)
    left, std = 100.0 * margins.T
    events = tuple((results[place].stream, results[place].seq) for place in places)
    return Past(clutch=clutch, title=title, along=np.array(places, np.float64), left=left, std=std, events=events)


def _thinned(past: Past, along: FloatArray, new_fluids: Sequence[float]) -> Past:
    """Return a past over the axis that is drawn, with the points that are drawn of it."""
    starts, numbers = np.searchsorted(along, new_fluids).tolist(), np.arange(len(along), dtype=np.float64)
    left, places, wide, numbers = broken(starts, MOST_POINTS, past.left, along, STDS * past.std, numbers)
    return replace(past, along=along, drawn=(places, left, wide, numbers))


def _odometer_km(results: Sequence[ShiftResult]) -> FloatArray:
    """Return how far the vehicle had come at each result, shape (n,), ending with what its odometer reads now.

    A step back or a leap is another instrument cluster. NaN where the odometer is not known of most.
    """
    read_m = np.array([result.estimate.conditions.odometer_m for result in results], np.float64)  # None becomes NaN
    places = np.flatnonzero(np.isfinite(read_m))
    if 2 * len(places) <= len(results):
        return np.full(len(results), np.nan)
    steps_m = np.diff(read_m[places], prepend=read_m[places[0]])
    gone_m = np.cumsum(np.where((steps_m >= 0.0) & (steps_m <= UNSEEN_M), steps_m, 0.0))
    now_m = read_m[places[-1]]
    return np.asarray(np.interp(np.arange(len(results)), places, now_m + gone_m - gone_m[-1]) / M_PER_KM)


def _moments(
    clutch: int,
    results: Sequence[ShiftResult],
    along: FloatArray,
    fills: Sequence[FluidFill],
    alarms: Sequence[tuple[str, str]],
) -> list[tuple[float, str, str]]:
    """Return where fluid was filled, a baseline frozen, the vehicle calibrated and the verdict on a clutch worse."""
    starts = [utc_from_bus_ns(result.estimate.start_ns) for result in results]
    happened = [(fill.filled_at, "fill", "new fluid") for fill in fills] + [(at, "alarm", text) for at, text in alarms]
    firsts = [(sum(start < at for start in starts), kind, text) for at, kind, text in happened]
    moments = [(float(along[min(first, len(along) - 1)]), kind, text) for first, kind, text in firsts]
    places = zip(along.tolist(), results, strict=True)
    verdicts = [(place, result.verdict) for place, result in places if result.verdict.clutch == clutch]
    for (_, before), (place, now) in pairwise(verdicts):
        is_calibrated = [(verdict.calibration_ratio or 0.0) >= CALIBRATED_RATIO for verdict in (before, now)]
        word = now.condition.name.lower()
        changes = (
            (before.trend is None and now.trend is not None, "base", "baseline"),
            (is_calibrated == [False, True], "base", "calibrated"),
            (before.condition < now.condition > Condition.GOOD, word, word.replace("_", " ")),
        )
        moments += [(place, kind, text) for is_so, kind, text in changes if is_so]
    return sorted(moments)[-MOST_MOMENTS:]


def fan_picture(fan: Fan) -> Markup:
    """Return the fan as SVG; its text says what can be seen."""
    first, (x, y) = fan.pasts[0], fan.axes
    now = f"{first.title}: {first.left[-1]:.0f} ± {STDS * first.std[-1]:.0f} % left"
    plot = Plot(f"Friction margin over {fan.label}; {now}", x, y, width=FAN_SIZE[0], height=FAN_SIZE[1])
    across = np.array([x.low, x.high])
    for low, high, style in ((y.low, 0.0, "change"), (0.0, WATCH_PERCENT, "watch")):
        plot.band(across, np.full(2, low), np.full(2, high), f"zone {style}")
    if len(fan.ahead):
        plot.band(fan.ahead, fan.quantiles[0], fan.quantiles[2], "band ahead")
        plot.line(fan.ahead, np.where(fan.quantiles[1] > y.low, fan.quantiles[1], np.nan), "line dashed ahead")
    for past in reversed(fan.pasts):
        along, left, wide, _ = past.drawn
        if past is first:
            plot.band(along, left - wide, left + wide, f"band clutch{past.clutch}")
        plot.line(along, left, f"line {'strong ' if past is first else ''}clutch{past.clutch}")
    for level, style, text in LIMITS:
        plot.level(level, style, text, is_left=True)
    for mark in fan.marks:
        plot.moment(mark.place, mark.kind, mark.text if mark.row is not None else "", row=mark.row or 0)
    return plot.markup()


def fan_record(fan: Fan) -> dict[str, Any]:
    """Return what a script draws the fan from; a margin that is not known, as at new fluid, is null."""
    streams = sorted({stream for past in fan.pasts for stream, _ in past.events})
    pasts = []
    for past in fan.pasts:
        along, left, wide, number = (column[:-1] for column in past.drawn)
        along = np.where(np.isnan(along), np.roll(along, 1) + 1e-3, along)
        rising = np.diff(np.maximum.accumulate(along), prepend=-np.inf) > 0.0  # as a chart needs it
        events = [None if np.isnan(place) else past.events[int(place)] for place in number[rising]]
        pasts.append(
            {
                "clutch": past.clutch,
                "title": past.title,
                "x": along[rising].tolist(),
                **{
                    name: [None if np.isnan(value) else round(value, 2) for value in values[rising].tolist()]
                    for name, values in (("left", left), ("low", left - wide), ("high", left + wide))
                },
                "events": [None if event is None else [streams.index(event[0]), event[1]] for event in events],
            }
        )
    low, high = fan.axes[1].low, fan.axes[1].high
    quantiles = np.where(fan.quantiles < low, low, fan.quantiles)
    return {
        "label": fan.label,
        "watch": WATCH_PERCENT,
        "range": [low, high],
        "pasts": pasts,
        "streams": streams,
        "marks": [(mark.place, mark.text, mark.row) for mark in fan.marks],
        "ahead": fan.ahead.tolist(),
        "quantiles": quantiles.round(2).tolist(),
    }


def curve_picture(
    clutch: int,
    friction: FrictionEstimate,
    reference: FrictionCurve,
    element: str | None = None,
    size: tuple[int, int] = (WIDTH, HEIGHT),
) -> Markup:
    """Return the friction of one clutch over slip, beside that of new fluid and the thresholds of the verdict."""
    new = new_curve(_SLIP_RAD_S, reference)
    mean, std = curve_band(_SLIP_RAD_S, friction, reference)
    low, high = mean - STDS * std, mean + STDS * std
    levels = [ratio * reference.mu_c for ratio, _ in _THRESHOLDS]
    slip_rpm = rpm_from_rad_s(_SLIP_RAD_S)
    x = Axis(low=0.0, high=float(slip_rpm[-1]), label="slip speed [rpm]")
    what = "friction coefficient over slip speed, estimate with band, new fluid, thresholds"
    y = Axis.around("friction coefficient", new, low, high, levels)
    plot = Plot(f"{title_of(clutch, element)}: {what}", x, y, width=size[0], height=size[1])
    for ratio, style in _THRESHOLDS:
        plot.level(ratio * reference.mu_c, style, f"{style}: {100.0 * ratio:.0f} %")
    plot.line(slip_rpm, new, "line new dashed")
    plot.band(slip_rpm, low, high, f"band clutch{clutch}")
    plot.line(slip_rpm, mean, f"line strong clutch{clutch}")
    return plot.markup()


KIND_STYLES: Final = ("clutch1", "clutch2", "ink", "new dashed")  # of lines, one a kind of event


def shifting_picture(
    results: Sequence[ShiftResult], measure: Measure, size: tuple[int, int]
) -> tuple[Markup, list[tuple[str, str]]] | None:
    """Return a measure of the commonest kinds of event along the drives, and what its lines stand for.

    Of one drive each event is a point, of several each drive. None where no kind has two points. ``results`` are of one
    vehicle, the oldest first.
    """
    drives = drives_of(results)
    place, along = _along(drives)
    kinds = sorted(shifting_of(results).rows, key=lambda row: (row.kind not in GEAR_CHANGES, -row.event_count))
    lines: list[tuple[str, FloatArray, FloatArray]] = []
    for row in kinds:
        points = [
            [
                (at, value)
                for at, estimate in zip(places, (result.estimate for result in drive), strict=True)
                if (estimate.kind, estimate.from_gear, estimate.to_gear) == (row.kind, row.from_gear, row.to_gear)
                and (value := measure.read(estimate)[0]) is not None
            ]
            for places, drive in zip(along, drives, strict=True)
        ]
        told = points[0] if len(drives) == 1 else [tuple(np.mean(group, axis=0)) for group in points if group]
        if len(told) > 1 and len(lines) < len(KIND_STYLES):
            x, y = np.array(sorted(told), np.float64).T
            drawn = thinned(y, MOST_POINTS)
            lines.append((row.name, x[drawn], measure.scale * y[drawn]))
    if not lines:
        return None
    unit = f" [{measure.unit}]" if measure.unit else ""
    x_axis = Axis.around(place, *(x for _, x, _ in lines), margin_ratio=0.02)
    y_axis = Axis.around(f"{measure.name}{unit}", [0.0], *(y for *_, y in lines))
    plot = Plot(f"{measure.name} over {place}: the table has the means", x_axis, y_axis, width=size[0], height=size[1])
    for style, (_, x, y) in zip(KIND_STYLES, lines, strict=False):
        plot.line(x, y, f"line {style}")
    return plot.markup(), [(style, name) for style, (name, *_) in zip(KIND_STYLES, lines, strict=False)]


def _along(drives: Sequence[Sequence[ShiftResult]]) -> tuple[str, list[list[float]]]:
    """Return over what events are drawn, and the place of each: minutes of one drive, kilometres, days or drives."""
    starts_s = [[result.estimate.start_ns / NS_PER_S for result in drive] for drive in drives]
    first_s, last_s = starts_s[0][0], starts_s[-1][-1]
    if len(drives) == 1:
        return "time in the drive [min]", [[(at_s - first_s) / 60.0 for at_s in starts_s[0]]]
    odometers_m = [[result.estimate.conditions.odometer_m for result in drive] for drive in drives]
    known_m = [[odometer_m for odometer_m in drive if odometer_m is not None] for drive in odometers_m]
    if [len(drive) for drive in known_m] == [len(drive) for drive in drives]:
        flat_m = [odometer_m for drive in known_m for odometer_m in drive]
        if max(flat_m) - min(flat_m) >= LEAST_KM * M_PER_KM:
            return "odometer [km]", [[odometer_m / M_PER_KM for odometer_m in drive] for drive in known_m]
    if first_s * NS_PER_S >= DATED_NS and last_s - first_s >= SECONDS_A_DAY:
        return "days since the first drive", [
            [(at_s - first_s) / SECONDS_A_DAY for at_s in drive] for drive in starts_s
        ]
    return "drive", [[float(number)] * len(drive) for number, drive in enumerate(drives, 1)]
