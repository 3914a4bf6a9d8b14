"""Pictures and tables of a report: friction over slip, its trend, the signals of a shift."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from markupsafe import Markup

from canlog.arrays import FloatArray
from clutch_model.calibration import FrictionCurve
from clutch_model.units import degc_from_k, rad_s_from_rpm, rpm_from_rad_s
from clutch_results.curves import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO, curve_band, new_curve
from clutch_results.loads import ENERGY_BOUNDS_J, Load
from clutch_results.records import Causes, ClutchVerdict, FrictionEstimate, ShiftResult, utc_from_bus_ns
from clutch_results.shift_course import COURSE_COUNT, Course, change_words, part_words
from clutchdiag_io.pages.content import Cell, Figure, Key, Section, Table, number
from clutchdiag_io.pages.plot import Axis, Plot, broken, thinned
from clutchdiag_io.people import PLUS_MINUS, STDS
from fleet_contract.orders import cause_words, title_of

MOST_POINTS: Final = 600  # of a trend; a screen shows no more
MOST_MOMENTS: Final = 8  # names of moments do not overlap too much
_SLIP_RAD_S: Final = rad_s_from_rpm(np.linspace(0.0, 400.0, 121))
TABLE_SLIPS_RAD_S: Final = rad_s_from_rpm(np.array([0.0, 20.0, 50.0, 100.0, 200.0, 400.0]))
THRESHOLD_KEYS: Final = (
    Key(style="watch", text=f"watch below {100.0 * WATCH_LEVEL_RATIO:.0f} % of new"),
    Key(style="change", text=f"change below {100.0 * CHANGE_LEVEL_RATIO:.0f} % of new"),
)
_THRESHOLDS: Final = ((1.0, "new"), (WATCH_LEVEL_RATIO, "watch"), (CHANGE_LEVEL_RATIO, "change"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """How the friction of one clutch went, an item per event that engaged it; NaN where nothing is known."""

    clutch: int
    single_mu_c: FloatArray  # (n,) of the event alone
    mu_c: FloatArray  # (n,) of all events so far
    std_mu_c: FloatArray  # (n,)
    new_mu_c: float | None  # of the calibration
    moments: tuple[tuple[int, str, str], ...]  # number of the event, kind, text
    title: str  # name of the clutch

    @property
    def number(self) -> FloatArray:
        """The numbers of the events, from 1 on, shape (n,)."""
        return np.arange(1.0, len(self.mu_c) + 1.0)

    @classmethod
    def of(cls, clutch: int, results: Sequence[ShiftResult], fills: Sequence[str]) -> "Trend":
        """Return the trend of the results of one clutch; ``fills`` are the moments of new fluid, ISO 8601 UTC."""
        running = [result.verdict.friction for result in results]
        levels = [result.verdict for result in results if result.verdict.level_ratio and result.verdict.friction]
        return cls(
            clutch=clutch,
            single_mu_c=np.array([_mu_c(result.estimate.friction) for result in results]),
            mu_c=np.array([_mu_c(one) for one in running]),
            std_mu_c=np.array([np.nan if one is None else one.std_mu_c for one in running]),
            new_mu_c=new_mu_c_of(levels[-1]) if levels else None,
            moments=tuple(_moments(results, fills)),
            title=title_of(clutch, results[-1].verdict.element if results else None),
        )


def curve_picture(
    clutch: int, friction: FrictionEstimate, reference: FrictionCurve, element: str | None = None
) -> Markup:
    """Return the friction of one clutch over slip, beside that of new fluid and the thresholds of the verdict."""
    new = new_curve(_SLIP_RAD_S, reference)
    mean, std = curve_band(_SLIP_RAD_S, friction, reference)
    low, high = mean - STDS * std, mean + STDS * std
    levels = [ratio * reference.mu_c for ratio, _ in _THRESHOLDS]
    slip_rpm = rpm_from_rad_s(_SLIP_RAD_S)
    x = Axis(low=0.0, high=float(slip_rpm[-1]), label="slip speed [rpm]")
    what = "friction coefficient over slip speed, estimate with band, new fluid, thresholds"
    plot = Plot(f"{title_of(clutch, element)}: {what}", x, Axis.around("friction coefficient", new, low, high, levels))
    _draw_thresholds(plot, reference.mu_c)
    plot.line(slip_rpm, new, "line new dashed")
    plot.band(slip_rpm, low, high, f"band clutch{clutch}")
    plot.line(slip_rpm, mean, f"line strong clutch{clutch}")
    return plot.markup()


def curve_figure(
    clutch: int,
    friction: FrictionEstimate,
    reference: FrictionCurve,
    what: str | None = None,
    element: str | None = None,
) -> Figure:
    """Return the friction of one clutch over slip with its numbers; ``what`` says of which events, if not of all."""
    new = new_curve(TABLE_SLIPS_RAD_S, reference)
    mean, std = curve_band(TABLE_SLIPS_RAD_S, friction, reference)
    rows = tuple(
        (number(rpm_from_rad_s(float(slip)), "{:.0f}"), number(value), number(STDS * one), number(fresh))
        for slip, value, one, fresh in zip(TABLE_SLIPS_RAD_S, mean, std, new, strict=True)
    )
    caption = f"{title_of(clutch, element)}: friction over slip{f', {what}' if what else ''}"
    return Figure(
        picture=curve_picture(clutch, friction, reference, element),
        caption=caption,
        keys=(
            Key(style=f"clutch{clutch}", text=what or "estimate, all shifts"),
            Key(style=f"band clutch{clutch}", text=PLUS_MINUS),
            Key(style="new dashed", text="new fluid"),
            *THRESHOLD_KEYS,
        ),
        table=Table(caption=caption, head=("slip [rpm]", "estimate", PLUS_MINUS, "new fluid"), rows=rows),
    )


def trend_picture(trend: Trend) -> Markup:
    """Return how the friction of one clutch went, thinned to what a screen can show."""
    number, std = trend.number, STDS * trend.std_mu_c
    levels = [] if trend.new_mu_c is None else [ratio * trend.new_mu_c for ratio, _ in _THRESHOLDS]
    y = Axis.around("mu_C", trend.single_mu_c, trend.mu_c - std, trend.mu_c + std, np.array(levels))
    x = Axis(low=0.0, high=len(number) + 1.0, label=f"event of {trend.title.lower()}")
    plot = Plot(f"{trend.title}: trend of mu_C, single events and running estimate with band", x, y)
    if trend.new_mu_c is not None:
        _draw_thresholds(plot, trend.new_mu_c)
    single = thinned(trend.single_mu_c, MOST_POINTS)
    fills = [place - 1 for place, style, _ in trend.moments if style == "fill"]
    mu_c, along, spread = broken(fills, MOST_POINTS, trend.mu_c, number, std)
    plot.band(along, mu_c - spread, mu_c + spread, f"band clutch{trend.clutch}")
    plot.dots(number[single], trend.single_mu_c[single], f"clutch{trend.clutch}")
    plot.line(along, mu_c, f"line strong clutch{trend.clutch}")
    for place, style, text in trend.moments[-MOST_MOMENTS:]:
        plot.moment(float(place), style, text)
    return plot.markup()


def _draw_thresholds(plot: Plot, new_mu_c: float) -> None:
    for ratio, style in _THRESHOLDS:
        plot.level(ratio * new_mu_c, style, f"{style}: {100.0 * ratio:.0f} %")


def _moments(results: Sequence[ShiftResult], fills: Sequence[str]) -> list[tuple[int, str, str]]:
    """Return where fluid was filled, the baseline was frozen and the verdict changed, by number of the event."""
    moments: list[tuple[int, str, str]] = []
    starts = [utc_from_bus_ns(result.estimate.start_ns) for result in results]
    for filled_at in fills:
        place = next((number for number, start in enumerate(starts, 1) if start >= filled_at), len(starts) + 1)
        moments.append((place, "fill", "new fluid"))
    known: ClutchVerdict | None = None
    for place, result in enumerate(results, 1):
        verdict = result.verdict
        if known is not None and verdict.trend is not None and known.trend is None:
            moments.append((place, "base", "baseline"))
        if known is not None and verdict.condition is not known.condition:
            word = verdict.condition.name.lower()
            moments.append((place, word, word.replace("_", " ")))
        known = verdict
    return sorted(moments)


def _mu_c(friction: FrictionEstimate | None) -> float:
    return np.nan if friction is None else friction.mu_c


def new_mu_c_of(verdict: ClutchVerdict) -> float | None:
    """Return mu_C of new fluid by the calibration that a verdict went by, None while that has no level."""
    if verdict.friction is None or not verdict.level_ratio:
        return None
    return verdict.friction.mu_c / verdict.level_ratio


def causes_section(causes: Causes) -> Section:
    """Return why a vehicle is as it is."""
    rows = tuple(
        (cause_words(one.cause, one.clutch), number(one.probability, "{:.1%}"), one.evidence) for one in causes.likely
    )
    table = Table(
        caption=f"Causes, by {causes.event_count} events", head=("cause", "probability", "evidence"), rows=rows
    )
    texts = (causes.advice, *([] if causes.test is None else [causes.test]))
    figures = (_moved_figure(causes),) if causes.moved else ()
    return Section(name="causes", title="Why", texts=texts, figures=figures, tables=(table,))


def _moved_figure(causes: Causes) -> Figure:
    """Return what moved most, in standard deviations, beside what the likeliest cause would move."""
    heights = np.arange(len(causes.moved), 0.0, -1.0)
    sizes = np.array([(one.change / one.std, one.expected / one.std) for one in causes.moved])
    caption = "What moved most, and what the likeliest cause would move"
    x = Axis.around("change over its standard deviation", [0.0], sizes[:, 0] - STDS, sizes[:, 0] + STDS, sizes[:, 1])
    plot = Plot(caption, x, Axis(low=0.4, high=len(heights) + 0.9, label=""))
    plot.moment(0.0, "fill", "unchanged")
    for height, (moved, expected), one in zip(heights, sizes, causes.moved, strict=True):
        plot.level(float(height), "new", one.quantity)
        plot.line(moved + np.array([-STDS, STDS]), np.array([height, height]), "line strong clutch2")
        plot.line(np.array([expected, expected]), height + np.array([-0.2, 0.2]), "line strong clutch1")
    rows = tuple(
        (one.quantity, *(number(value, "{:.3g}") for value in (one.change, STDS * one.std, one.expected)), one.unit)
        for one in causes.moved
    )
    return Figure(
        picture=plot.markup(),
        caption=caption,
        keys=(Key(style="clutch2", text=f"moved, {PLUS_MINUS}"), Key(style="clutch1", text="expected")),
        table=Table(caption=caption, head=("quantity", "moved", PLUS_MINUS, "expected", "unit"), rows=rows),
    )


def course_tables(found: Sequence[Course], loaded: Sequence[Load]) -> tuple[Table, ...]:
    """Return how well gear changes went, and what the clutches had to bear."""
    rows = tuple(
        (
            change_words(one),
            str(one.count),
            *(number(score, "{:.0f}") for score in (one.first, one.last, *one.by_oil)),
            part_words(one.reason),
        )
        for one in found
    )
    ends = (f"first {COURSE_COUNT}", f"last {COURSE_COUNT}")
    head = ("change", "count", *ends, "cold oil", "warm", "hot", "mostly costs")
    scores = Table(caption="Score of the gear changes, 100 is faultless", head=head, rows=rows)
    bounds = [f"{bound_j / 1e3:g}" for bound_j in ENERGY_BOUNDS_J]
    names = (f"up to {bounds[0]} kJ", *(f"to {bound}" for bound in bounds[1:]), "more")
    load_rows = tuple(map(_load_row, loaded))
    load_head = ("clutch", *names, "all [MJ]", "hottest [°C]", "launches", "lining consumed")
    load = Table(caption="Events by slip energy, and what they sum up to", head=load_head, rows=load_rows)
    return tuple(table for table in (scores, load) if table.rows)


def _load_row(load: Load) -> tuple[Cell, ...]:
    is_told = any(load.counts)  # by pressures
    energy_mj, peak_k = load.energy_j / 1e6, load.peak_k
    return (
        str(load.clutch),
        *(number(count if is_told else None, "{}") for count in load.counts),
        number(energy_mj if is_told else None, "{:.2f}"),
        number(None if peak_k is None else degc_from_k(peak_k), "{:.0f}"),
        str(load.launch_count),
        number(load.life_ratio if is_told else None, "{:.4%}"),
    )
