"""The routes: each checks the parameters of an address, asks snapshot or database, and fills a template or JSON."""

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from datetime import date, datetime, timedelta
from functools import wraps
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Any, Final, TypeVar
from zlib import crc32

import msgspec
from sqlalchemy import Engine
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, RedirectResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles

from clutch_model.units import reading_of
from clutch_results.pictures import THRESHOLD_KEYS, UNFORETOLD, curve_picture, fan_picture, fan_record
from clutch_results.prognosis import Prognosis
from clutch_results.prognosis.assumptions import HORIZON_M
from clutch_results.prognosis.sentence import distance_left, soonest
from clutch_results.records import Causes, FrictionEstimate
from clutch_results.shift_course import course_lines, courses, loads
from clutchdiag_io.people import PER_1000_RPM, SLOPE_UNIT, STDS, digits
from fleet_backend import queries as common
from fleet_backend.ageing import results
from fleet_backend.ageing.calibrations import reference_of
from fleet_backend.ageing.peers import latest_population
from fleet_backend.ageing.prognosis import (
    NO_PROGNOSIS,
    due_of,
    fan_of_vehicle,
    outlook_answer,
    outlook_text,
    read_past,
)
from fleet_backend.ageing.records import ClutchNow, Due, Fill, Severity
from fleet_backend.ageing.shifting import answer_of, shifting_tables, summary_of
from fleet_backend.alarms import book
from fleet_backend.alarms.book import Note
from fleet_backend.alarms.rules import AlarmRule, Subject
from fleet_backend.config import parse_moment
from fleet_backend.errors import AskError, BackendConfigError, NotFoundError, UnknownVehicleError
from fleet_backend.office_tables import ALARM
from fleet_backend.page import queries
from fleet_backend.page.access import UserRole
from fleet_backend.page.fleet import WEEKS, FleetSnapshot, vehicle_type, worse_clutch
from fleet_backend.page.flight import Streamed, text_pieces
from fleet_backend.page.questions import (
    ORDERS,
    Acknowledgement,
    AlarmsQuery,
    ListQuery,
    NewFluid,
    ShiftQuery,
    VehicleQuery,
    VehiclesQuery,
)
from fleet_backend.page.site import (
    API,
    asked,
    encoded,
    form_of,
    is_api,
    is_known,
    listed,
    page,
    sources_of,
    streamed,
    viewer_of,
)
from fleet_backend.page.wording import M_PER_KM, STEPS, address
from fleet_backend.queries import Row
from fleet_backend.schema import FRICTION_TIER
from fleet_contract.orders import UNKNOWN_FLUID, Action, name_of

RowT = TypeVar("RowT")
MOST_FOR_PEOPLE: Final = 1000  # rows of a page
AS_ABOVE: Final = "as above"  # in place of a sentence that would stand in the next row again
NEWEST: Final = 25  # events of each clutch on a page
MOST_DRAWN: Final = 100  # pages that a snapshot keeps, and the bytes of each: others are drawn whenever they are asked
LARGEST_DRAWN: Final = 200_000


def drawn_once(draw: Callable[[Request], Response]) -> Callable[[Request], Response]:
    """Return a route that draws each page once while snapshot and days hold: it is made of these alone."""

    @wraps(draw)
    def answer(request: Request) -> Response:
        keeper = sources_of(request).keeper
        drawn = keeper.snapshot.drawn
        who, state = viewer_of(request), (keeper.dues_number, keeper.words_number, keeper.complaint)
        key = (str(request.url), request.headers.get("if-none-match"), who, state)
        if key not in drawn:
            made = draw(request)
            if len(drawn) >= MOST_DRAWN or isinstance(made, Streamed) or len(made.body) > LARGEST_DRAWN:
                return made
            drawn[key] = made
        kept: Response = drawn[key]
        return kept

    return answer


@drawn_once
def vehicles(request: Request) -> Response:
    """List every vehicle as its worse clutch is, the worst first, and how many have each verdict."""
    query, sources = asked(request, VehiclesQuery), sources_of(request)
    keeper, snapshot, mark = sources.keeper, sources.keeper.snapshot, sources.keeper.mark
    if is_known(request, mark):
        return Response(status_code=304)
    groups = {"due": snapshot.due, "silent": snapshot.silent, "alarm": snapshot.alarmed, "untold": snapshot.untold}
    matching: Sequence[ClutchNow] = _matching(snapshot.worst, query)
    if query.only is not None:
        matching = [now for now in matching if now.vehicle in groups[query.only]]
    if query.sort is not None:
        key = ORDERS[query.sort.removeprefix("-")]
        matching = sorted(matching, key=lambda now: (key(now), now.vehicle), reverse=query.sort.startswith("-"))
    if request.url.path == CSV_PATH:
        shown, today = matching[query.offset : query.offset + query.limit], sources.now().date()
        shown = list(map(keeper.with_shifting, shown))
        dues = ((now, due_of(now, keeper.foretold(now), today)) for now in shown)
        return streamed(request, _csv(dues), "text/csv")
    part, next_offset = _part(request, query, matching)
    rows = list(map(keeper.with_shifting, part))
    counts = sum(map(Counter, snapshot.strips.values()), Counter[str]())
    answer = {
        "matching_count": len(matching),
        "vehicle_count": len(snapshot.worst),
        "counts": {severity.value: counts[severity.value] for severity in Severity},
        "due_count": len(snapshot.due),
        "silent_count": len(snapshot.silent),
        "alarm_count": len(snapshot.alarmed),
        "untold_count": len(snapshot.untold),
        "next": next_offset,
    }
    if is_api(request):
        return listed(request, answer, "vehicles", rows)
    context = _list(request, query, {"vehicles": rows, **answer}) | {
        "csv_href": address(CSV_PATH, **_filters(query)),
        "heads": [_head(text, name, query) for text, name in _COLUMNS],
        "orders": _ORDERS,
        "strips": _strips(snapshot),
        "tiles": [(name, len(groups[name]), text) for name, text in _TILES.items()],
        "sparks": {now.vehicle: keeper.curve(now) for now in rows},
        "types": {now.vehicle: vehicle_type(now) for now in rows},
        "dues": {now.vehicle: due_of(now, keeper.foretold(now), sources.now().date()) for now in rows},
    }
    return page(request, "fleet.html", context, mark=mark)


def _csv(rows: Iterable[tuple[ClutchNow, Due]]) -> Iterator[bytes]:
    names = [field.name for field in fields(ClutchNow)]
    values_of = attrgetter(*names)
    values = ([*values_of(now), *_due_values(due)] for now, due in rows)
    return text_pieces(map(_csv_line, chain([[*names, *_OF_DUE]], values)))


def _csv_line(values: Iterable[object]) -> str:
    out = io.StringIO()
    csv.writer(out).writerow(values)
    return out.getvalue()


_OF_DUE: Final = ("due_from", "left_m", "least_left_m")
_due_values: Final = attrgetter(*_OF_DUE)
CSV_PATH: Final = "/vehicles.csv"
_TILES: Final = {
    "due": "due within 30 days",
    "silent": "silent for 14 days",
    "alarm": "with an open alarm",
    "untold": "cannot tell friction",
}
_COLUMNS: Final = (  # and by which word each sorts
    *(
        ("vehicle", "vehicle"),
        ("tier", "tier"),
        ("verdict", ""),
        ("what to do", ""),
        ("due from", ""),
        ("km left", ""),
        ("of new", "level"),
    ),
    *(("last score", ""), ("km", "km"), ("fluid", "fluid"), ("type", "type"), ("last event (UTC)", "last")),
)
_ORDERS: Final = (  # for screens that show no heads of columns
    ("", "worst first"),
    *((sign + name, f"{text} {way}") for text, name in _COLUMNS if name for sign, way in (("", "up"), ("-", "down"))),
)
_MOST_STRIPS: Final = 12


def _head(text: str, name: str, query: VehiclesQuery) -> str | dict[str, str]:
    """Return the head of a column; its link sorts upwards, and downwards where the column is sorted upwards."""
    if not name:
        return text
    ways = {name: "ascending", f"-{name}": "descending"}
    parameters = _filters(query) | {"sort": f"-{name}" if query.sort == name else name}
    return {"text": text, "way": ways.get(query.sort or "", ""), "href": address("/", **parameters)}


def _strips(snapshot: FleetSnapshot) -> list[tuple[str, list[tuple[str, int, int]], int]]:
    """Return for the largest types how many vehicles have which verdict, the worst first, and where each begins."""
    largest = sorted(snapshot.strips.items(), key=lambda strip: (-sum(strip[1].values()), strip[0]))[:_MOST_STRIPS]
    strips = []
    for name, counts in largest:
        parts, start = list[tuple[str, int, int]](), 0
        for condition in Severity:
            if counts.get(condition, 0):
                parts.append((condition.value, counts[condition], start))
                start += counts[condition]
        strips.append((name, parts, start))
    return strips


def _matching(clutches: Sequence[ClutchNow], query: VehiclesQuery) -> Sequence[ClutchNow]:
    """Return the clutches that are looked for, in the order in which they come."""
    if query.q:
        part = query.q.casefold()
        clutches = [now for now in clutches if part in now.vehicle.casefold()]
    for name in ("condition", "fluid", "tier"):
        if (value := getattr(query, name)) is not None:
            clutches = [now for now in clutches if getattr(now, name) == value]
    if query.since is not None or query.until is not None:
        since, until = query.since or date.min, query.until or date.max
        clutches = [now for now in clutches if since <= now.end_at.date() <= until]
    if query.calibration is not None:
        clutches = [now for now in clutches if query.calibration in {now.calibration_version, vehicle_type(now)}]
    return clutches


def _limit(request: Request, query: ListQuery) -> int:
    return query.limit if is_api(request) else min(query.limit, MOST_FOR_PEOPLE)


def _part(request: Request, query: ListQuery, rows: Sequence[RowT]) -> tuple[Sequence[RowT], int | None]:
    """Return the part of a list that is asked for, and the offset of the next part."""
    end = query.offset + _limit(request, query)
    return rows[query.offset : end], end if len(rows) > end else None


def _list(request: Request, query: ListQuery, answer: Mapping[str, Any]) -> dict[str, Any]:
    """Return the context of each list: its part, its filters, and the link to the next part."""
    link = None if answer["next"] is None else address(request.url.path, **_filters(query), offset=answer["next"])
    return {"answer": answer, "query": query, "following": link}


def _filters(query: ListQuery) -> dict[str, Any]:
    return {name: value for name, value in msgspec.to_builtins(query).items() if name != "offset"}


def vehicle(request: Request) -> Response:
    """Show one vehicle: its clutches now, how far their fluid will go, and their past."""
    query, sources = asked(request, VehicleQuery), sources_of(request)
    name, engine = query.vehicle, sources.engine
    clutches = sources.keeper.snapshot.vehicles.get(name, ())
    mark = crc32(repr([(now.stream, now.seq, now.order, now.fluid_since) for now in clutches]).encode())
    if is_known(request, mark):
        return Response(status_code=304)
    state = queries.vehicle_of(engine, name)
    if state is None:
        raise NotFoundError(f"no message was ever received of a vehicle {name}")
    fills, stored = results.fills_of(engine, name), queries.stored_of(engine, name)
    population = latest_population(engine)
    pasts = [read_past(engine, now, fills, query.service_km * M_PER_KM, population) for now in clutches]
    estimates = [estimate for past in pasts for estimate in past.estimates]
    first = clutches[0] if clutches else None
    tier = worse_clutch(clutches).tier if clutches else None
    is_told = tier is None or tier == FRICTION_TIER
    shifting = None if is_told else summary_of([row for past in pasts for row in past.rows], estimates)
    answer = {
        "vehicle": name,
        "is_online": None if state["is_online"] is None else bool(state["is_online"]),
        "connected_at": state["connected_at"],
        "last_result_at": max((at for _, at in stored.values() if at is not None), default=None),
        "service_version": state["service_version"],
        "action": first and first.action,
        "order": first and first.order,
        "outlook": outlook_text((past.prognosis for past in pasts), first) if first and is_told else None,
        "tier": tier,
        "shifting": None if shifting is None else answer_of(shifting),
        "fills": fills,
        "alarms": book.alarms(engine, ALARM.c.vehicle == name),
        "clutches": [
            {
                "now": now,
                "outlook": outlook_answer(past),
                "why_no_outlook": NO_PROGNOSIS if past.prognosis is None else None,
                "event_count": len(past.rows),
                "trend": past.trend(None if is_api(request) else NEWEST),
                "result_count": stored.get(now.clutch, (0, None))[0],
            }
            for now, past in zip(clutches, pasts, strict=True)
        ],
        "changes": courses(estimates),
        "loads": loads(estimates),
        "causes": _causes(request, clutches),
    }
    if is_api(request):
        return encoded(answer)
    fan = fan_of_vehicle(clutches, pasts, fills, answer["alarms"]) if clutches else None
    prognoses = [past.prognosis for past in pasts if past.prognosis is not None] if is_told else []
    context = {
        "answer": answer,
        "fan": fan,
        "fan_picture": "" if fan is None else fan_picture(fan),
        "fan_record": None if fan is None else fan_record(fan),
        "left": _left(clutches, fills, prognoses),
        "odometer_m": max((now.odometer_m for now in clutches if now.odometer_m is not None), default=None),
        "distance": distance_left(prognoses, Action(first.action)).capitalize() if first and is_told else "",
        "steps": STEPS.get(Action(first.action), ()) if first and is_told else (),
        "shifting_tables": [] if shifting is None else shifting_tables(shifting),
        "happened": sorted(_happened(fills, answer["alarms"]), key=lambda event: event[0], reverse=True),
        "lines": course_lines(answer["changes"]),
        "assumptions": dict.fromkeys(
            text for clutch in answer["clutches"] if clutch["outlook"] for text in clutch["outlook"]["assumptions"]
        ),
        "now": sources.now(),
    }
    return page(request, "vehicle.html", context, mark=mark)


def _left(
    clutches: Sequence[ClutchNow], fills: Sequence[Fill], prognoses: Sequence[Prognosis]
) -> dict[str, Any] | None:
    """Return how far the fluid has gone and how far it will go, in words and in parts of 1000; None: not known."""
    reaches = (prognosis.change_fluid for prognosis in prognoses)
    reach = soonest(prognoses) or next((reach for reach in reaches if reach is not None), None)
    odometers_m = [now.odometer_m for now in clutches if now.odometer_m is not None]
    if reach is None or not odometers_m or clutches[0].action in UNFORETOLD:
        return None
    filled_m = fills[-1].odometer_m if fills else None
    age_m = 0.0 if filled_m is None else max(max(odometers_m) - filled_m, 0.0)
    text = "" if filled_m is None else f"Fluid: {age_m / M_PER_KM:,.0f} km old. "
    ends_m = [age_m + (HORIZON_M if end_m is None else end_m) for end_m in (0.0, reach.p10_m, reach.p50_m, reach.p90_m)]
    return {
        "text": text + distance_left(prognoses, Action(clutches[0].action)).capitalize(),
        "parts": [round(1000.0 * end_m / max(ends_m[-1], M_PER_KM), 1) for end_m in ends_m],
    }


def _happened(
    fills: Sequence[Fill], alarms_of_vehicle: Sequence[Row]
) -> Iterator[tuple[datetime, str, float | None, str | None]]:
    """Yield fluid changes and alarms of a vehicle: when, what, at which distance, with which note.

    Of alarms that were raised at once each sentence stands once.
    """
    for fill in fills:
        yield fill.filled_at, f"new fluid: {fill.product}", fill.odometer_m, fill.note
    raised: dict[tuple[datetime, str], list[str]] = {}
    for row, sentence in zip(alarms_of_vehicle, _sentences(alarms_of_vehicle), strict=True):
        alarm = _alarm_name(row)
        raised.setdefault((row["raised_at"], sentence), []).append(alarm)
        if row["acknowledged_at"] is not None:
            yield row["acknowledged_at"], f"alarm {alarm} acknowledged by {row['acknowledged_by']}", None, row["note"]
        if row["cleared_at"] is not None:
            yield row["cleared_at"], f"alarm {alarm} over", None, None
    for (at, reason), names in raised.items():
        yield at, f"alarm {' and '.join(names)}: {reason}", None, None


def _sentences(alarm_rows: Sequence[Row]) -> list[str]:
    """Return the reason of each alarm; the longest in its place that was raised of its vehicle at once and holds it."""
    at_once: dict[tuple[str, datetime], list[str]] = {}
    for row in alarm_rows:
        at_once.setdefault((row["vehicle"], row["raised_at"]), []).append(row["reason"])
    return [
        max((other for other in at_once[row["vehicle"], row["raised_at"]] if row["reason"] in other), key=len)
        for row in alarm_rows
    ]


def _alarm_name(row: Row) -> str:
    """Return the rule of an alarm, and its clutch if it is of one alone."""
    return str(row["rule"]) if row["clutch"] is None else f"{row['rule']} of {name_of(row['clutch'], row['element'])}"


def _causes(request: Request, clutches: Sequence[ClutchNow]) -> Causes | None:
    """Return the causes in the last result of a vehicle; None if that is of an earlier fluid."""
    last = max(clutches, key=lambda now: now.end_at, default=None)
    if last is None or last.condition_reason == UNKNOWN_FLUID:
        return None
    event = results.shift_of(sources_of(request).engine, last.vehicle, last.stream, last.seq)
    return None if event is None else event["causes"]


def shift(request: Request) -> Response:
    """Show one event of a vehicle: its own estimate, the running one after it, and the quality of its data."""
    query = asked(request, ShiftQuery)
    answer = results.shift_of(sources_of(request).engine, query.vehicle, query.stream, query.seq)
    if answer is None:
        raise NotFoundError(f"{query.vehicle} has no event {query.seq} in this stream")
    if is_api(request):
        return encoded(answer)
    clutch, quality = answer["clutch"], answer["shift_quality"]
    reference = reference_of(query.vehicle, answer["calibration_version"], clutch)
    estimates = ((answer["friction"], "this event alone"), (answer["running"], "all events so far"))
    context = {
        "answer": answer,
        "figures": [
            (text, curve_picture(clutch, FrictionEstimate(**values), reference, answer["element"]))
            for values, text in estimates
            if values is not None and reference is not None
        ],
        "thresholds": THRESHOLD_KEYS,
        "has_reference": reference is not None,
        "quantities": _QUANTITIES,
        "parts": [] if quality is None else list(_parts(quality)),
    }
    return page(request, "shift.html", context)


_QUANTITIES: Final = (
    ("mu_C, at high slip", "mu_c", "std_mu_c", 1.0),
    ("mu_S, at no slip", "mu_s", "std_mu_s", 1.0),
    (f"slope {SLOPE_UNIT}", "slope_s_rad", "std_slope_s_rad", PER_1000_RPM),
)


def _parts(quality: Mapping[str, Any]) -> Iterator[tuple[str, float, str, str, str]]:
    """Yield the parts of a score as people read them: name, value, its text, what stands behind ±, unit."""
    for name, value in quality.items():
        if (reading := reading_of(quality, name)) is not None:
            label, shown, std, unit = reading
            yield label, value, digits(shown), "" if std is None else digits(STDS * std), unit


def alarms(request: Request) -> Response:
    """List the alarms that rules raised, the latest first."""
    query = asked(request, AlarmsQuery)
    part = query.offset, _limit(request, query)
    rows, next_offset = queries.alarms_of(sources_of(request).engine, *part, state=query.state, rule=query.rule)
    answer = {"alarms": rows, "next": next_offset}
    if is_api(request):
        return encoded(answer)
    known, reasons = set[tuple[str, str]](), list[str]()
    for row, sentence in zip(rows, _sentences(rows), strict=True):
        reasons.append(AS_ABOVE if (row["vehicle"], sentence) in known else sentence)
        known.add((row["vehicle"], sentence))
    context = {"rules": [rule.value for rule in AlarmRule], "reasons": reasons}
    return page(request, "alarms.html", _list(request, query, answer) | context)


@drawn_once
def maintenance(request: Request) -> Response:
    """List when the fluids of the fleet are due, in the order of their days."""
    query, sources = asked(request, ListQuery), sources_of(request)
    keeper, today = sources.keeper, sources.now().date()
    clutches, lanes = keeper.calendar(today)
    rows, next_offset = _part(request, query, clutches)

    def due(now: ClutchNow) -> Due:
        return due_of(now, keeper.foretold(now), today)

    answer = {"clutch_count": len(clutches), "next": next_offset}
    if is_api(request):
        return listed(request, answer, "clutches", rows, due)
    dues = list(map(due, rows))
    context = {"weeks": _weeks(dues, today), "lanes": (_lane_heads(today), lanes)}
    return page(request, "maintenance.html", _list(request, query, {"clutches": dues, **answer}) | context)


def _lane_heads(today: date) -> list[str]:
    """Return the heads of the calendar: the weeks to come, by their Mondays."""
    monday = today - timedelta(days=today.weekday())
    mondays = (monday + timedelta(weeks=week) for week in range(1, WEEKS))
    return ["now", "this week", *(f"{day:%d %b}" for day in mondays), "later", "no day"]


def _weeks(dues: Sequence[Due], today: date) -> list[tuple[str, list[Due]]]:
    """Return the vehicles by the week from which they are due, what is overdue first, what has no day last.

    Both clutches of a vehicle slip in one oil, so only the first of them is listed.
    """
    weeks: dict[str, list[Due]] = {}
    vehicles_listed = set[str]()
    for due in dues:
        if due.vehicle in vehicles_listed:
            continue
        vehicles_listed.add(due.vehicle)
        if due.is_overdue or (due.due_from is not None and due.due_from <= today):
            week = "Now"
        elif due.due_from is None:
            week = "No day known"
        else:
            week = f"Week of {due.due_from - timedelta(days=due.due_from.weekday())}"
        weeks.setdefault(week, []).append(due)
    return list(weeks.items())


async def acknowledge(request: Request) -> Response:
    """Acknowledge an alarm, once."""
    form = await form_of(request, Acknowledgement, UserRole.WORKSHOP)
    writer, by = _writer_of(request)
    subject = Subject(vehicle=form.vehicle, clutch=form.clutch, rule=form.rule)
    note = Note(**by, at=sources_of(request).now(), text=form.note)
    if not await run_in_threadpool(book.acknowledge, writer, subject, form.number, note):
        raise AskError("there is no such alarm, or somebody else has already acknowledged it")
    return RedirectResponse("/alarms", status_code=303)


async def change_fluid(request: Request) -> Response:
    """Note that a vehicle got new fluid, or take a fill back; the same fill is noted once."""
    form = await form_of(request, NewFluid, UserRole.WORKSHOP)
    (writer, by), sources = _writer_of(request), sources_of(request)

    def write() -> None:
        at = None if form.at is None else parse_moment(form.at)
        if form.undo:
            common.withdraw_fill(writer, form.vehicle, at, **by)
        elif form.product is None:
            raise AskError("product: which fluid is in?")
        else:
            odometer_m = None if form.odometer_km is None else form.odometer_km * M_PER_KM
            details: dict[str, Any] = {"at": at or sources.now(), "odometer_m": odometer_m, "note": form.note}
            common.note_fill(writer, form.vehicle, form.product, **details, **by)

    try:
        await run_in_threadpool(write)
    except (BackendConfigError, UnknownVehicleError) as exc:
        raise AskError(str(exc)) from exc
    await sources.keeper.look()
    return RedirectResponse(address(f"/vehicles/{form.vehicle}"), status_code=303)


def _writer_of(request: Request) -> tuple[Engine, dict[str, Any]]:
    """Return the database that can be changed, and who changes it, for the audit."""
    writer, viewer = sources_of(request).writer, viewer_of(request)
    if writer is None or viewer.name is None:
        raise NotFoundError("this server is read-only")
    return writer, {"by": viewer.name, "role": viewer.role.name.lower()}


PAGES: Final = {  # by address; JSON is at the same address below API
    "/vehicles": vehicles,
    "/vehicles/{vehicle}": vehicle,
    "/vehicles/{vehicle}/shift": shift,
    "/alarms": alarms,
    "/maintenance": maintenance,
}
LEFT: Final = {  # addresses of earlier releases: the page that people get, and where programs find the same
    "/clutches": ("/", f"{API}/vehicles and {API}/vehicles/NAME"),
    "/changes": ("/", f"{API}/vehicles and {API}/vehicles/NAME"),
    "/alarm": ("/alarms", f"{API}/alarms?state=all"),
    "/quarantine": ("/", "fleet-backend quarantine --json"),
}


def routes() -> list[BaseRoute]:
    """Return all routes."""
    static = StaticFiles(packages=[("fleet_backend.page", "static"), ("clutchdiag_io.pages", "templates")])
    return [
        Route("/", vehicles),
        *(Route(path, handler) for path, handler in PAGES.items() if handler is not vehicles),
        *(Route(API + path, handler) for path, handler in PAGES.items()),
        Route("/alarm/acknowledge", acknowledge, methods=["POST"]),
        Route("/vehicles/{vehicle}/fluid", change_fluid, methods=["POST"]),
        *(Route(path, RedirectResponse(page_now, status_code=301)) for path, (page_now, _) in LEFT.items()),
        *(Route(API + path, _left_for(program_now)) for path, (_, program_now) in LEFT.items()),
        Route(CSV_PATH, vehicles),
        Route(f"{API}/openapi.json", _description),
        Mount("/static", static),
    ]


def _description(_: Request) -> Response:
    return FileResponse(Path(__file__).with_name("static") / "openapi.json")


def _left_for(successor: str) -> Callable[[Request], Response]:
    def refuse(_: Request) -> Response:
        raise HTTPException(410, f"this left: use {successor}")

    return refuse
