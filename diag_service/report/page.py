"""A report as one HTML file: written whole or not at all, it loads nothing and runs nothing."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Final

import numpy as np
from markupsafe import Markup

from canlog.files import replacing
from clutch_model.units import NS_PER_S, bar_from_pa, rpm_from_rad_s
from clutch_results import records
from clutch_results.event_kinds import DATED_NS, events_text
from clutch_results.pictures import (
    MOST_MOMENTS,
    MOST_POINTS,
    THRESHOLD_KEYS,
    Trend,
    causes_section,
    course_tables,
    curve_figure,
    trend_picture,
)
from clutch_results.shift_course import course_lines, courses, loads
from clutchdiag_io.pages.content import NONE, Advice, Cell, Figure, Key, Section, Table, number, spread, templates_of
from clutchdiag_io.pages.plot import Axis, Plot, thinned
from clutchdiag_io.people import PER_1000_RPM, PLUS_MINUS, SLOPE_UNIT, STDS, plus_minus
from clutchdiag_io.program import legible, legible_record
from diag_service.delivery.console import condition_words, gear_words, kind_words, reason_words
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.condition.verdict import likely
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.prediction import RelativeFriction
from diag_service.diagnosis.summary import (
    capability_line,
    frames_line,
    gaps_line,
    newest_causes,
    reason_text,
    summary_record,
    values_line,
)
from diag_service.errors import StoreError
from diag_service.report.findings import Example, Findings, moment_words
from diag_service.report.history import outlook_of
from diag_service.store import Row
from fleet_contract import JsonObject
from fleet_contract.orders import SHOWN_AS, Order, title_of

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


REPORT_SCHEMA: Final = "clutchdiag/report/v1"
_PACKAGE: Final = "diag_service.report"
WHAT_CURVES_SAY: Final = (
    "New fluid: friction rises with slip speed. Old fluid: it is lower at high slip and higher at low slip. Where the "
    "curve falls to the right, the clutch can shudder."
)
MOST_ROWS: Final = 100  # of the table of events
TREND_ROWS: Final = 12
SAMPLE_ROWS: Final = 9


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """A whole report."""

    title: str
    subtitle: str
    advice: tuple[Advice, ...]
    sections: tuple[Section, ...]
    record: object  # the same for programs, as JSON has it
    is_full: bool = False  # whether paper gets all sections


def page_of(found: Findings, made_at: str, *, is_full: bool = False) -> Page:
    """Return the page of a report; ``made_at`` is the present moment (ISO 8601 UTC)."""
    causes = [] if (known := newest_causes(found.latest)) is None else [causes_section(known)]
    sections = (
        brief_section(found),
        *causes,  # before the rest: they may say that what the verdict advises will not help
        friction_section(found),
        trend_section(found),
        shifts_section(found),
        *course_sections(found),
        quality_section(found),
        _unseen_section(found),
        events_section(found),
        _versions_section(found, made_at),
    )
    return Page(
        title=f"Clutches of {found.vehicle}",
        subtitle=_subtitle(found),
        advice=(advice_of(found.order),),
        sections=sections,
        record=legible_record(record_of(found)),
        is_full=is_full,
    )


def record_of(found: Findings) -> JsonObject:
    """Return what the page says in numbers, as `analyze --json` tells it."""
    return {
        "schema": REPORT_SCHEMA,
        "vehicle": found.vehicle,
        **records.order_record(found.order),
        "clutches": [records.clutch_record(records.shift_record(result), found.order) for result in found.latest],
        "summary": None if found.summary is None else summary_record(found.summary),
    }


def html_of(page: Page) -> str:
    return templates_of(_PACKAGE).get_template("report.html").render(page=page)


def write_page(path: Path, page: Page) -> int:
    """Write a page and return its size in bytes; raises StoreError if the disk does not take it."""
    content = html_of(page).encode("utf-8", "backslashreplace")
    with replacing(path, StoreError) as part:
        part.write_bytes(content)
        part.replace(path)
    return len(content)


def advice_of(order: Order) -> Advice:
    """Return the order for a vehicle, as a page shows it."""
    condition = SHOWN_AS[order.action]
    return Advice(condition=condition.replace("_", "-"), word=condition.replace("_", " "), text=order.text)


def _subtitle(found: Findings) -> str:
    names = ", ".join(legible(name) for name in found.sources)
    if not found.rows:
        return f"no event in {names}"
    # Logs may have been analysed in any order.
    starts_ns = (result.estimate.start_ns for result in found.results)
    begin_ns = min(t_ns for t_ns in starts_ns if t_ns >= DATED_NS * found.is_dated)
    end_ns = max(result.estimate.end_ns for result in found.results)
    days = dict.fromkeys(records.utc_from_bus_ns(t_ns)[:10] for t_ns in (begin_ns, end_ns))  # one twice is one
    when = " to ".join(days) if found.is_dated else "without a date"
    return f"{events_text(len(found.rows))}, {when}, from {names}"


def _unseen_section(found: Findings) -> Section:
    """Return what was not seen and why, and what became of the frames."""
    engaged = {result.estimate.clutch for result in found.results}
    texts = [f"{found.title(clutch)}: no event engaged it." for clutch in found.clutches if clutch not in engaged]
    if found.left_out_count:
        texts.append(f"{found.left_out_count} results of other algorithms or calibrations are left out.")
    summary = found.summary
    if summary is not None:
        lines = (gaps_line(summary.gaps), capability_line(summary), values_line(summary.frames))
        texts += [line for line in (*lines, *map(legible, summary.contributions.idle)) if line]
        if summary.capability.unseen and capability_line(summary) == "":
            texts.append(f"mapped, but never seen: {', '.join(summary.capability.unseen)}")
        texts.append(f"On the bus: {frames_line(summary.frames)}.")
    else:
        texts.append("A store keeps only results. The report of a log tells what happened to its frames.")
    return Section(name="unseen", title="What was not seen, and why", texts=tuple(texts))


def _versions_section(found: Findings, made_at: str) -> Section:
    rows = (
        ("program", f"clutchdiag {version('clutchdiag')}"),
        ("algorithm", found.versions.algorithm),
        ("calibration", found.versions.calibration),
        ("results", records.SHIFT_SCHEMA),
        ("made at (UTC)", made_at[:19].replace("T", " ")),
    )
    table = Table(caption="Versions", head=("what", "version"), rows=rows)
    return Section(name="versions", title="Versions", tables=(table,))


def brief_section(found: Findings) -> Section:
    """Return what a workshop asks first: how far it goes, what is in, and the friction of the worse clutch."""
    known_m = [one.estimate.odometer_m for one in found.results if one.estimate.odometer_m is not None]
    fill = found.fills[-1] if found.fills else None
    filled = (NONE, NONE, NONE) if fill is None else (fill.product or NONE, fill.filled_at[:10], _km(fill.odometer_m))
    rows = (
        ("km left", outlook_of(found)),
        ("odometer [km]", _km(known_m[-1] if known_m else None)),
        *zip(("fluid", "filled on", "filled at [km]"), filled, strict=True),
    )
    facts = Table(caption="The vehicle and its fluid; – is not known", head=("what", "value"), rows=rows)
    told = [one.verdict for one in found.latest if one.verdict.friction or one.verdict.slope]
    worst = min(told, key=lambda one: (-one.condition, one.level_ratio or 1.0), default=None)
    figures = () if worst is None else tuple(replace(one, table=facts) for one in _curve_of(found, worst))
    texts = () if worst is None else (_why(worst),)
    return Section(name="brief", title="At a glance", texts=texts, tables=() if figures else (facts,), figures=figures)


def _why(verdict: records.ClutchVerdict) -> str:
    """Return what the verdict on a clutch rests on, in one sentence for a workshop."""
    friction, slope, level, share = verdict.friction, verdict.slope, verdict.level_ratio, ""
    if friction is not None and level is not None:
        off = level * friction.std_mu_c / friction.mu_c
        share = f", and at high slip it is {plus_minus(level, off, '{:.0f}', scale=100.0)} % of that of new fluid"
    elif slope is not None:
        ratio = plus_minus(slope.mu_s_ratio, slope.std_mu_s_ratio, "{:.0f}", scale=100.0)
        share = f", and at no slip it is {ratio} % of that at high slip"
    falling = (
        friction.probability_negative_slope if friction is not None else slope.probability_negative if slope else 0.5
    )
    title, shifts = title_of(verdict.clutch, verdict.element), _shifts_text(verdict.shift_count)
    return f"{title}: that friction falls with slip is {likely(falling)}{share} ({shifts}; {PLUS_MINUS})."


def _shifts_text(count: int) -> str:
    return f"{count} shift{'' if count == 1 else 's'}"


def _km(distance_m: float | None) -> Cell:
    return number(None if distance_m is None else distance_m / 1000.0, "{:.0f}")


def _curve_of(found: Findings, verdict: records.ClutchVerdict) -> Iterator[Figure]:
    """Yield the friction of a clutch over slip, if that and its calibration are known."""
    if found.calibration is not None and verdict.friction is not None:
        reference = found.calibration.clutches[verdict.clutch - 1].friction
        yield curve_figure(verdict.clutch, verdict.friction, reference, element=verdict.element)


def friction_section(found: Findings) -> Section:
    """Return friction over slip of each clutch, or why there is none."""
    texts = [WHAT_CURVES_SAY]
    if found.calibration is None:
        texts.append(
            f"Curves are not drawn: the results were made with calibration {found.versions.calibration}, which is not "
            "the one at hand; name it by --calibration."
        )
    figures = [figure for result in found.latest for figure in _curve_of(found, result.verdict)]
    tables = [_numbers_table(result.verdict) for result in found.latest]
    tables += [] if found.summary is None else [_relative_table(one) for one in found.summary.relative]
    return Section(name="friction", title="Friction", texts=tuple(texts), tables=tuple(tables), figures=tuple(figures))


def trend_section(found: Findings) -> Section:
    """Return how the friction of each clutch went."""
    figures, texts = [], list[str]()
    for clutch in found.clutches:
        results = [result for result in found.results if result.estimate.clutch == clutch]
        trend = Trend.of(clutch, results, [fill.filled_at for fill in found.fills])
        if not np.isfinite(trend.mu_c).any():
            continue
        figures.append(_trend_figure(trend, results))
        if len(results) > MOST_POINTS:
            texts.append(
                f"{found.title(clutch)}: {len(results)} events; of each stretch of about "
                f"{2 * len(results) / MOST_POINTS:.0f} the lowest and the highest are drawn."
            )
        if len(trend.moments) > MOST_MOMENTS:
            texts.append(
                f"{found.title(clutch)}: the last {MOST_MOMENTS} of {len(trend.moments)} changes of verdict, fluid and "
                "baseline are marked."
            )
    if not figures:
        texts.append("No clutch has a running estimate, so there is no trend.")
    return Section(name="trend", title="Trend", texts=tuple(texts), figures=tuple(figures))


def shifts_section(found: Findings) -> Section:
    """Return the pictures of single shifts, one that was used and one that was not."""
    texts = list[str]()
    if found.summary is None:
        texts.append("A store keeps no signals; the report of a log shows single shifts as pictures.")
    kept = {example.result.estimate.status for example in found.examples}
    if found.summary is not None and records.Status.VALID not in kept:
        texts.append("No shift could be used.")
    if found.summary is not None and records.Status.REJECTED not in kept:
        texts.append("No shift was rejected.")
    figures = [figure for example in found.examples for figure in shift_figures(example)]
    return Section(name="shifts", title="Single shifts", texts=tuple(texts), figures=tuple(figures))


def course_sections(found: Findings) -> Iterator[Section]:
    """Yield how well the gear changes went and what the clutches had to bear, if that is known."""
    estimates = [result.estimate for result in found.results]
    if known := courses(estimates):
        tables = course_tables(known, loads(estimates))
        yield Section(name="course", title="How well it shifts", texts=tuple(course_lines(known)), tables=tables)


def events_section(found: Findings) -> Section:
    """Return the table of events; of many the newest."""
    rows = found.rows[-MOST_ROWS:]
    texts = [f"The newest {len(rows)} of {len(found.rows)} events."] if len(rows) < len(found.rows) else []
    start = "start (UTC)" if found.is_dated else "start in the log"
    head = ("event", start, "kind", "gears", "clutch", "data", "mu_C", PLUS_MINUS, "verdict after it", "reasons")
    table = Table(caption="Events", head=head, rows=tuple(_event_cells(row, is_dated=found.is_dated) for row in rows))
    return Section(name="events", title="Events", texts=tuple(texts), tables=(table,))


def quality_section(found: Findings) -> Section:
    """Return how far the data could be believed."""
    counts = Counter(result.estimate.status for result in found.results)
    reasons = Counter(reason for result in found.results for reason in result.estimate.reasons)
    total = len(found.results)
    by_status = {status.value: counts[status] for status in records.Status}
    tables = [_share_table("Quality of the data of the events", by_status, total)]
    if reasons:
        named = {reason_text(reason): count for reason, count in reasons.most_common()}
        tables.append(_share_table("Why events were not used", named, total))
    parts = _quality_rows(found.results)
    if parts:
        head = ("part", "mean", "lowest", "events")
        tables.append(Table(caption="Quality of the data, from 0 to 1", head=head, rows=tuple(parts)))
    return Section(name="quality", title="Data quality", tables=tuple(tables))


def _numbers_table(verdict: records.ClutchVerdict) -> Table:
    title = title_of(verdict.clutch, verdict.element)
    return Table(
        caption=f"{title}: running estimate from {_shifts_text(verdict.shift_count)}",
        head=("quantity", "value", PLUS_MINUS),
        rows=tuple(_number_rows(verdict)),
    )


def _relative_table(found: RelativeFriction) -> Table:
    numbers = {f"event {number} over the others": one for number, one in found.shifts.items()}
    numbers[f"change {SLOPE_UNIT} of slip"] = found.slope_s_rad * PER_1000_RPM
    numbers["change from the first to the last"] = found.trend
    return Table(
        caption=f"Clutch {found.clutch}: friction in power upshifts, up to a scale that is not known",
        head=("quantity", "value", PLUS_MINUS),
        rows=tuple(
            (name, number(one.value, "{:.3f}"), number(STDS * one.std, "{:.3f}")) for name, one in numbers.items()
        ),
    )


def _slope_cells(slope_s_rad: float, std_s_rad: float) -> tuple[Cell, Cell]:
    return number(slope_s_rad, scale=PER_1000_RPM), number(STDS * std_s_rad, scale=PER_1000_RPM)


def _number_rows(verdict: records.ClutchVerdict) -> Iterator[tuple[Cell, ...]]:
    friction, slope = verdict.friction, verdict.slope
    if friction is not None:
        yield "mu_C, at high slip", number(friction.mu_c), number(STDS * friction.std_mu_c)
        yield "mu_S, at no slip", number(friction.mu_s), number(STDS * friction.std_mu_s)
        if verdict.level_ratio is not None:
            std_ratio = friction.std_mu_c / friction.mu_c * verdict.level_ratio
            yield "mu_C over new", number(verdict.level_ratio, "{:.1%}"), number(STDS * std_ratio, "{:.1%}")
        yield f"slope {SLOPE_UNIT}", *_slope_cells(friction.slope_s_rad, friction.std_slope_s_rad)
        yield "probability of a falling slope", number(friction.probability_negative_slope, "{:.1%}"), NONE
    elif slope is not None and verdict.scale_free is not None:
        yield "mu_C up to a scale", number(verdict.scale_free.mu_c), number(STDS * verdict.scale_free.std_mu_c)
        yield "mu_S over mu_C", number(slope.mu_s_ratio, "{:.3f}"), number(STDS * slope.std_mu_s_ratio, "{:.3f}")
        yield "probability of a falling slope", number(slope.probability_negative, "{:.1%}"), NONE
    else:
        yield "friction", NONE, NONE
        return
    if (micro := verdict.micro_slip) is not None:
        rpm = f"{micro.slip_rad_s * 30.0 / np.pi:.0f} rpm"
        yield f"mu at {rpm}", number(micro.mu), number(STDS * micro.std_mu)
        yield f"slope at {rpm}, {SLOPE_UNIT}", *_slope_cells(micro.slope_s_rad, micro.std_slope_s_rad)
        yield "slip that it rests on [min]", number(micro.slip_s / 60.0, "{:.0f}"), NONE
        if (seen := micro.shudder) is not None:
            swung = f"{seen.seen_count} of {seen.window_count} windows"
            yield "slip that swings by itself, last event", swung, NONE
    for name, since in (("baseline", verdict.trend), ("first fluid", verdict.lining)):
        if since is not None:
            yield (
                f"change of mu_C since the {name}",
                number(since.change_mu_c_ratio, "{:+.1%}"),
                number(STDS * since.std_change_mu_c_ratio, "{:.1%}"),
            )


def _trend_figure(trend: Trend, results: list[records.ShiftResult]) -> Figure:
    is_dated = any(result.estimate.end_ns >= DATED_NS for result in results)
    rows = tuple(_trend_cells(place, results[place], is_dated=is_dated) for place in spread(trend.mu_c, TREND_ROWS))
    clutch = trend.clutch
    return Figure(
        picture=trend_picture(trend),
        caption=f"{trend.title}: trend of mu_C",
        keys=(
            Key(style=f"dots clutch{clutch}", text="single events"),
            Key(style=f"clutch{clutch}", text="estimate from all events so far"),
            Key(style=f"band clutch{clutch}", text=PLUS_MINUS),
            *THRESHOLD_KEYS,
        ),
        table=Table(
            caption=f"{trend.title}: {len(rows)} of {events_text(len(results))}, evenly spread",
            head=("event", "end (UTC)" if is_dated else "end in the log", "km", "mu_C", PLUS_MINUS, "verdict"),
            rows=rows,
        ),
    )


def _trend_cells(place: int, result: records.ShiftResult, *, is_dated: bool) -> tuple[Cell, ...]:
    friction, odometer_m = result.verdict.friction, result.estimate.odometer_m
    return (
        str(place + 1),
        moment_words(result.estimate.end_ns, is_dated=is_dated),
        _km(odometer_m),
        number(None if friction is None else friction.mu_c),
        number(None if friction is None else STDS * friction.std_mu_c),
        condition_words(result.verdict.condition),
    )


def shift_figures(example: Example) -> Iterator[Figure]:
    estimate = example.result.estimate
    reasons = reason_words(estimate)
    what = f"{estimate.status.value}{f' ({reasons})' if reasons else ''}"
    name = f"Event {estimate.number}, {kind_words(estimate)} {gear_words(estimate)}, {what}"
    for panel in PANELS:
        curves = present_curves(panel, example.event)
        if curves:
            yield Figure(
                picture=shift_picture(panel, example.event),
                caption=f"{name}: {panel.title.lower()}",
                keys=tuple(Key(style=one.style, text=one.label) for one in curves),
                table=_samples_table(panel, example, name),
            )


def _samples_table(panel: Panel, example: Example, name: str) -> Table:
    event = example.event
    curves = present_curves(panel, event)
    t_s = np.linspace(0.0, max(event.end_ns - event.start_ns, 1) / NS_PER_S, SAMPLE_ROWS)
    columns = []
    for one in curves:
        series = event.columns[one.signal]
        since_s = (series.t_ns - event.start_ns) / NS_PER_S
        columns.append(np.interp(t_s, since_s, series.value * panel.factor))
    rows = tuple(
        (number(moment, "{:.2f}"), *(number(column[row], "") for column in columns))
        for row, moment in enumerate(t_s.tolist())
    )
    head = ("time [s]", *(one.label for one in curves))
    return Table(caption=f"{name}: {panel.title.lower()} [{panel.unit}]", head=head, rows=rows)


def _event_cells(row: Row, *, is_dated: bool) -> tuple[Cell, ...]:
    result = row.result
    estimate, friction = result.estimate, result.estimate.friction
    return (
        str(row.position),
        moment_words(estimate.start_ns, is_dated=is_dated),
        kind_words(estimate),
        gear_words(estimate),
        estimate.element or str(estimate.clutch),
        estimate.status.value,
        number(None if friction is None else friction.mu_c),
        number(None if friction is None else STDS * friction.std_mu_c),
        condition_words(result.verdict.condition),
        reason_words(estimate) or NONE,
    )


def _share_table(caption: str, counts: dict[str, int], total: int) -> Table:
    rows = tuple((name, str(count), f"{100.0 * count / max(total, 1):.0f} %") for name, count in counts.items())
    return Table(caption=caption, head=("", "events", "share"), rows=rows)


def _quality_rows(results: tuple[records.ShiftResult, ...]) -> Iterator[tuple[Cell, ...]]:
    known = [result.estimate.data_quality for result in results if result.estimate.data_quality is not None]
    if not known:
        return
    values = {"all": [one.score for one in known]}
    values |= {part.value: [one.parts[part] for one in known if part in one.parts] for part in records.QualityPart}
    for name, scores in values.items():
        if scores:
            yield name, number(float(np.mean(scores)), "{:.2f}"), number(min(scores), "{:.2f}"), str(len(scores))
