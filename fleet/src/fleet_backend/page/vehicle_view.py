"""One vehicle: what to do, how far its fluid will go, and how each clutch went."""

from collections.abc import Iterator, Sequence
from math import isfinite
from typing import Any, Final

from clutch_results.loads import Load
from clutch_results.pictures import causes_section, course_tables
from clutch_results.records import Causes
from clutch_results.shift_course import course_lines
from clutchdiag_io.pages.content import NONE, Cell, Figure, Link, Section, Table, moment, number, spread
from clutchdiag_io.people import PLUS_MINUS, STDS, moment_words
from fleet_backend.alarms import book
from fleet_backend.errors import NotFoundError
from fleet_backend.office_tables import ALARM
from fleet_backend.page import past, wording
from fleet_backend.page.asking import VEHICLE, Ask, Parameter, ParameterType
from fleet_backend.page.cache import Same
from fleet_backend.page.keeper import group_of
from fleet_backend.page.listing import vehicle_type
from fleet_backend.page.outlook import Past, outlook_text, read_past
from fleet_backend.page.pictures import (
    Course,
    Quantity,
    course_keys,
    course_picture,
)
from fleet_backend.page.records import Alarm, ClutchHistory, ClutchNow, TrendPoint, Usual, VehicleAnswer
from fleet_backend.page.vehicle_state import VehicleState, state_of
from fleet_backend.page.view import Shown, Sources, View, list_section
from fleet_contract.orders import UNKNOWN_FLUID, Action, name_of, title_of

SERVICE_KM: Final = 15_000
_MOST_SERVICE_KM: Final = 300_000
_TREND_ROWS: Final = 12
_EVENT_ROWS: Final = 25
_PARAMETERS: Final = (
    VEHICLE,
    Parameter(
        name="service_km",
        text="distance to the next service [km]",
        kind=ParameterType.COUNT,
        most=_MOST_SERVICE_KM,
        default=SERVICE_KM,
    ),
)


def find(sources: Sources, ask: Ask) -> VehicleAnswer:
    """Return what is known of a vehicle; raises NotFoundError if nothing is."""
    vehicle, service_distance_m = ask.said("vehicle"), ask.count("service_km") * wording.M_PER_KM
    state = state_of(sources.engine, vehicle)
    if state is None:
        raise NotFoundError(f"no message was ever received of a vehicle {vehicle}")
    snapshot = sources.keeper.snapshot
    clutches = snapshot.vehicles.get(vehicle, ())
    usual = tuple(snapshot.usual.get(group_of(now)) for now in clutches)

    def make() -> VehicleAnswer:
        pasts = [past_of(sources, now, state, service_distance_m) for now in clutches]
        action, order = (clutches[0].action, clutches[0].order) if clutches else (None, None)
        return VehicleAnswer(
            vehicle=vehicle,
            is_online=state.is_online,
            connected_at=state.connected_at,
            last_result_at=state.last_result_at,
            service_version=state.service_version,
            action=action,
            order=order,
            outlook=outlook_text((one.prognosis for one in pasts), clutches[0]) if clutches else None,
            fills=state.fills,
            alarms=tuple(Alarm(**one) for one in book.alarms(sources.engine, ALARM.c.vehicle == vehicle)),
            clutches=tuple(
                ClutchHistory(
                    now=now,
                    outlook=found.outlook,
                    why_no_outlook=found.why_no_outlook,
                    trend=found.trend,
                    result_count=state.stored_of(now.clutch).result_count,
                    usual=kind,
                )
                for now, found, kind in zip(clutches, pasts, usual, strict=True)
            ),
            changes=tuple(
                sorted(
                    (one for found in pasts for one in found.changes),
                    key=lambda one: (one.kind, one.from_gear, one.to_gear),
                )
            ),
            loads=_joined([load for found in pasts for load in found.loads]),
            causes=_causes(sources, clutches),
        )

    return sources.vehicles.of((vehicle, service_distance_m), (state, clutches, usual), make)


def show(answer: VehicleAnswer, ask: Ask, sources: Sources) -> Shown:
    sections = [] if answer.causes is None else [causes_section(answer.causes)]
    sections += [_outlook_section(answer)]
    sections += [_quality_section(answer)]
    sections += [_clutch_section(answer, one) for one in answer.clutches]
    sections += [_events_section(answer), _assumptions_section(answer)]
    return Shown(
        title=f"Vehicle {answer.vehicle}",
        subtitle=_subtitle(answer, sources),
        sections=tuple(one for one in sections if one.texts or one.figures or one.tables),
        advice=(wording.advice(answer.action, answer.order),) if answer.action and answer.order else (),
        trail=(Link(text="Fleet", href="/"),),
        more=(Link(text="What changed in a week, and why", href=f"/changes?q={answer.vehicle}"),),
        follows=ask.said("vehicle"),
    )


def past_of(sources: Sources, now: ClutchNow, state: VehicleState, service_distance_m: float) -> Past:
    """Return the past of a clutch, as it is kept or from the database."""
    made_of = (state.stored_of(now.clutch), state.fills, state.population_version, vehicle_type(now))
    key = (now.vehicle, now.clutch, service_distance_m)
    return sources.pasts.of(
        key, made_of, lambda: read_past(sources.engine, now.vehicle, now.clutch, state, service_distance_m)
    )


def _causes(sources: Sources, clutches: Sequence[ClutchNow]) -> Causes | None:
    """Return why a vehicle is as it is, as its last result says; of an earlier fluid nothing."""
    last = max(clutches, key=lambda one: one.end_at, default=None)
    if last is None or last.condition_reason == UNKNOWN_FLUID:
        return None
    found = past.shift_of(sources.engine, last.vehicle, last.stream, last.seq)
    return None if found is None else found.causes


def _subtitle(answer: VehicleAnswer, _sources: Sources) -> str:
    state = {None: "state of its service unknown", True: "online", False: "offline"}[answer.is_online]
    since = f" since {answer.connected_at:%Y-%m-%d %H:%M} UTC" if answer.connected_at and answer.is_online else ""
    at = answer.last_result_at
    last = f", last result {moment_words(at, '%Y-%m-%d %H:%M UTC')}" if at else ", no result yet"
    return f"{state}{since}{last}"


def _outlook_section(answer: VehicleAnswer) -> Section:
    is_foretold = answer.action not in {Action.CHANGE_NOW, Action.NEW_FLUID, Action.FIND_CAUSE}
    known = [one for one in answer.clutches if is_foretold and one.outlook and one.outlook.change_fluid]
    texts = () if answer.outlook is None else (answer.outlook,)
    return Section(
        name="outlook", title="How far the fluid will go", texts=texts, tables=tuple(map(_reach_table, known))
    )


def _reach_table(clutch: ClutchHistory) -> Table:
    found = clutch.outlook
    rows: list[tuple[Cell, ...]] = []
    for name, reach in () if found is None else (("watch", found.watch), ("change fluid", found.change_fluid)):
        if reach is not None:
            distances = (reach.p10_m, reach.p50_m, reach.p90_m)
            shown = ("beyond 300,000" if one is None else wording.km(one) for one in distances)
            rows.append((name, *shown, wording.probability(reach.probability_before_service)))
    head = ("limit", "10 % [km]", "50 % [km]", "90 % [km]", "probability before the next service")
    return Table(
        caption=f"{_title(clutch)}: distance until a limit is passed",
        head=head,
        rows=tuple(rows),
    )


def _title(clutch: ClutchHistory) -> str:
    return title_of(clutch.now.clutch, clutch.now.element)


def _joined(loads: Sequence[Load]) -> tuple[Load, ...]:
    """Return what each clutch had to bear in its own events and, as the off-going one, in those of the other."""
    return tuple(
        Load(
            clutch=clutch,
            counts=tuple(map(sum, zip(*(one.counts for one in own), strict=True))),
            energy_j=sum(one.energy_j for one in own),
            peak_k=max((one.peak_k for one in own if one.peak_k is not None), default=None),
            launch_count=sum(one.launch_count for one in own),
            life_ratio=sum(one.life_ratio for one in own),
        )
        for clutch in sorted({one.clutch for one in loads})
        for own in [[one for one in loads if one.clutch == clutch]]
    )


def _quality_section(answer: VehicleAnswer) -> Section:
    """Return how well gears were changed, and what the clutches had to bear."""
    texts, tables = course_lines(answer.changes), course_tables(answer.changes, answer.loads)
    return Section(name="shifting", title="How well it shifts", texts=tuple(texts), tables=tables)


def _assumptions_section(answer: VehicleAnswer) -> Section:
    told = dict.fromkeys(text for one in answer.clutches if one.outlook for text in one.outlook.assumptions)
    rows = tuple((str(number), text) for number, text in enumerate(told, 1))
    table = Table(caption="Assumptions", head=("", "assumption"), rows=rows)
    return Section(name="assumptions", title="What the outlook rests on", tables=(table,) if rows else ())


def _clutch_section(answer: VehicleAnswer, clutch: ClutchHistory) -> Section:
    name, texts = _title(clutch), []
    if clutch.result_count > len(clutch.trend):
        texts.append(
            f"The newest {len(clutch.trend)} of {clutch.result_count} stored results, older versions included."
        )
    if clutch.usual is not None:
        texts.append(_usual_text(clutch.usual, clutch.now.mu_c))
    figures = [_course_figure(answer, clutch, quantity) for quantity in Quantity if _is_told(quantity, clutch.trend)]
    newest = clutch.trend[::-1][:_EVENT_ROWS]
    events = Table(
        caption=f"{name}: the newest {len(newest)} events",
        head=(
            "end (UTC)",
            "km",
            "kind",
            "data",
            "mu_C",
            PLUS_MINUS,
            "running mu_C",
            PLUS_MINUS,
            "score",
            "verdict",
            "reasons",
        ),
        rows=tuple(map(_event_cells, newest)),
    )
    return Section(
        name=f"clutch-{clutch.now.clutch}", title=name, texts=tuple(texts), figures=tuple(figures), tables=(events,)
    )


def _is_told(quantity: Quantity, trend: Sequence[TrendPoint]) -> bool:
    return any(point.score is not None for point in trend) if quantity is Quantity.SCORE else bool(trend)


def _usual_text(usual: Usual, mu_c: float | None) -> str:
    text = (
        f"Of {usual.clutch_count} clutches of this type and fluid eight in ten have mu_C from {usual.low_mu_c:.4f} to "
        f"{usual.high_mu_c:.4f} now, half of them more than {usual.middle_mu_c:.4f}."
    )
    if mu_c is None or usual.low_mu_c <= mu_c <= usual.high_mu_c:
        return text
    return f"{text} This one has {'less' if mu_c < usual.low_mu_c else 'more'} than is usual."


def _course_figure(answer: VehicleAnswer, clutch: ClutchHistory, quantity: Quantity) -> Figure:
    """Return how a quantity went, with its numbers."""
    course = Course.of(clutch.now, quantity, clutch.trend, answer, clutch.usual)
    rows = spread(range(len(clutch.trend)), _TREND_ROWS)
    table = Table(
        caption=f"{_title(clutch)}, {quantity}: {len(rows)} of {len(clutch.trend)} events, evenly spread",
        head=("end (UTC)", "km", quantity, PLUS_MINUS, "verdict"),
        rows=tuple(_trend_cells(clutch.trend[row], course, row) for row in rows),
    )
    caption = f"{_title(clutch)}: trend of {quantity}"
    return Figure(picture=course_picture(course), caption=caption, keys=course_keys(course), table=table)


def _trend_cells(point: TrendPoint, course: Course, row: int) -> tuple[Cell, ...]:
    value, std = course.running[row], course.std_running[row]
    numbers = (value, STDS * std)
    return (
        wording.shift_link(moment_words(point.end_at), point.vehicle, point.stream, point.seq, at=point.end_at),
        wording.km(point.odometer_m),
        *(number(float(one) if isfinite(one) else None, course.quantity.form) for one in numbers),
        wording.badge(point.condition),
    )


def _event_cells(point: TrendPoint) -> tuple[Cell, ...]:
    return (
        wording.shift_link(
            moment_words(point.end_at, "%Y-%m-%d %H:%M:%S"), point.vehicle, point.stream, point.seq, at=point.end_at
        ),
        wording.km(point.odometer_m),
        wording.plain(point.kind and point.kind.replace("_", " ")),
        point.status,
        number(point.mu_c),
        number(point.std_mu_c and STDS * point.std_mu_c),
        number(point.running_mu_c),
        number(point.running_std_mu_c and STDS * point.running_std_mu_c),
        number(point.score, "{:.0f}"),
        wording.badge(point.condition),
        wording.words(point.reasons),
    )


def _events_section(answer: VehicleAnswer) -> Section:
    happened = [
        *(
            (fill.filled_at, f"new fluid: {fill.product}", wording.km(fill.odometer_m), fill.note)
            for fill in answer.fills
        ),
        *(entry for alarm in answer.alarms for entry in _alarm_entries(alarm)),
    ]
    rows = tuple(
        (moment(at), what, km, wording.plain(note))
        for at, what, km, note in sorted(happened, key=lambda one: one[0], reverse=True)
    )
    table = Table(caption="Fluid changes and alarms", head=("at (UTC)", "what", "km", "note"), rows=rows)
    return list_section("events", "What happened", table, "No new fluid was noted, and there was no alarm.")


def _alarm_entries(alarm: Alarm) -> Iterator[tuple[Any, str, Cell, str | None]]:
    whose = "" if alarm.clutch is None else f" of {name_of(alarm.clutch, alarm.element)}"
    yield alarm.raised_at, f"alarm{whose}: {alarm.reason}", NONE, None
    if alarm.acknowledged_at is not None:
        who = f"alarm{whose} acknowledged by {alarm.acknowledged_by}"
        yield alarm.acknowledged_at, who, NONE, alarm.note
    if alarm.cleared_at is not None:
        yield alarm.cleared_at, f"alarm{whose} over", NONE, None


VIEW: Final = View(
    name="vehicle",
    page_path="/vehicles/{vehicle}",
    text="One vehicle: its clutches now, how far their fluid will go, and their past.",
    parameters=_PARAMETERS,
    answer=VehicleAnswer,
    find=find,
    show=show,
    subtitle=_subtitle,
    state=Same,
)
