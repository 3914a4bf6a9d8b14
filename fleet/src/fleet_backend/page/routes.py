"""The routes: each a question whose words are checked, what answers it, and a template; programs get JSON."""

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from datetime import UTC, date, datetime, timedelta
from importlib.metadata import version
from operator import attrgetter
from typing import Any, Final, NamedTuple, TypeVar

import msgspec
from sqlalchemy import Engine
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
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
from fleet_backend.alarms import book
from fleet_backend.alarms.book import Note
from fleet_backend.alarms.rules import AlarmRule, Subject
from fleet_backend.errors import AskError, BackendConfigError, NotFoundError, UnknownVehicleError
from fleet_backend.office_tables import ALARM
from fleet_backend.page import queries
from fleet_backend.page.access import UserRole
from fleet_backend.page.calibrations import reference_of
from fleet_backend.page.fleet import SEVERITY, FleetSnapshot, Keeper, vehicle_type
from fleet_backend.page.news import News
from fleet_backend.page.prognosis import (
    NO_PROGNOSIS,
    days_of,
    due_of,
    fan_of_vehicle,
    outlook_answer,
    outlook_text,
    read_past,
)
from fleet_backend.page.questions import (
    ORDERS,
    Acknowledgement,
    AlarmQuery,
    AlarmsQuery,
    ListQuery,
    NewFluid,
    ShiftQuery,
    VehicleQuery,
    VehiclesQuery,
)
from fleet_backend.page.records import (
    Alarm,
    AlarmsAnswer,
    ClutchHistory,
    ClutchNow,
    Due,
    MaintenanceAnswer,
    QuarantineAnswer,
    Severity,
    ShiftAnswer,
    VehicleAnswer,
    VehiclesAnswer,
)
from fleet_backend.page.site import (
    API,
    Problem,
    asked,
    encoded,
    form_of,
    is_api,
    page,
    sources_of,
    viewer_of,
)
from fleet_backend.page.wording import M_PER_KM, STEPS, address
from fleet_contract.orders import UNKNOWN_FLUID, Action, name_of

RowT = TypeVar("RowT")
WEEKS: Final = 8  # of the calendar
MOST_FOR_PEOPLE: Final = 1000  # rows of a page


def vehicles(request: Request) -> Response:
    """Tell every vehicle as its worse clutch is, the worst first, and how many have each verdict."""
    query, sources = asked(request, VehiclesQuery), sources_of(request)
    keeper, snapshot = sources.keeper, sources.keeper.snapshot
    groups = {"due": snapshot.due, "silent": snapshot.silent, "alarm": snapshot.alarmed}
    found: Sequence[ClutchNow] = _matching(snapshot.worst, query)
    found = found if query.only is None else [one for one in found if one.vehicle in groups[query.only]]
    if query.sort is not None:
        of = ORDERS[query.sort.removeprefix("-")]
        found = sorted(found, key=lambda one: (of(one), one.vehicle), reverse=query.sort.startswith("-"))
    if request.url.path == CSV_PATH:
        return _csv(found[query.offset : query.offset + query.limit])
    some, following = _part(request, query, found)
    counts = Counter(one.condition for one in snapshot.worst)
    answer = VehiclesAnswer(
        vehicles=some,
        matching_count=len(found),
        vehicle_count=len(snapshot.worst),
        counts={one.value: counts[one.value] for one in Severity},
        due_count=len(snapshot.due),
        silent_count=len(snapshot.silent),
        alarm_count=len(snapshot.alarmed),
        next=following,
    )
    if is_api(request):
        return encoded(answer)
    shown = _list(request, query, answer) | {
        "csv_href": address(CSV_PATH, **_said(query)),
        "heads": [_head(text, name, query) for text, name in _COLUMNS],
        "orders": _ORDERS,
        "strips": _strips(snapshot),
        "tiles": [(name, len(groups[name]), text) for name, text in _TILES.items()],
        "sparks": {one.vehicle: keeper.curve(one) for one in some},
        "types": {one.vehicle: vehicle_type(one) for one in some},
        "dues": {one.vehicle: due_of(one, keeper.foretold(one), sources.now().date()) for one in some},
    }
    return page(request, "fleet.html", shown)


def _csv(rows: Sequence[ClutchNow]) -> Response:
    out, names = io.StringIO(), [field.name for field in fields(ClutchNow)]
    table = csv.writer(out)
    table.writerow(names)
    table.writerows(map(attrgetter(*names), rows))
    return Response(out.getvalue(), media_type="text/csv")


CSV_PATH: Final = "/vehicles.csv"
_TILES: Final = {"due": "due within 30 days", "silent": "silent for 14 days", "alarm": "with an open alarm"}
_COLUMNS: Final = (  # and by which word each sorts
    *(
        ("vehicle", "vehicle"),
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
    """Return the head of a column; it sorts upwards, and downwards where it sorts upwards already."""
    if not name:
        return text
    ways = {name: "ascending", f"-{name}": "descending"}
    said = _said(query) | {"sort": f"-{name}" if query.sort == name else name}
    return {"text": text, "way": ways.get(query.sort or "", ""), "href": address("/", **said)}


def _strips(snapshot: FleetSnapshot) -> list[tuple[str, list[tuple[str, int, int]], int]]:
    """Return the largest types with how many vehicles have which verdict, the worst first, and where each begins."""
    largest = sorted(snapshot.strips.items(), key=lambda one: (-sum(one[1].values()), one[0]))[:_MOST_STRIPS]
    found = []
    for name, counts in largest:
        parts, start = list[tuple[str, int, int]](), 0
        for condition in Severity:
            if counts.get(condition, 0):
                parts.append((condition.value, counts[condition], start))
                start += counts[condition]
        found.append((name, parts, start))
    return found


def _matching(clutches: Sequence[ClutchNow], query: VehiclesQuery) -> Sequence[ClutchNow]:
    """Return the clutches that are looked for, in the order in which they come."""
    if query.q:
        part = query.q.casefold()
        clutches = [now for now in clutches if part in now.vehicle.casefold()]
    for name in ("condition", "fluid"):
        if (wanted := getattr(query, name)) is not None:
            clutches = [now for now in clutches if getattr(now, name) == wanted]
    if query.since is not None or query.until is not None:
        since, until = query.since or date.min, query.until or date.max
        clutches = [now for now in clutches if since <= now.end_at.date() <= until]
    if query.calibration is not None:
        clutches = [now for now in clutches if query.calibration in {now.calibration_version, vehicle_type(now)}]
    return clutches


def _limit(request: Request, query: ListQuery) -> int:
    return query.limit if is_api(request) else min(query.limit, MOST_FOR_PEOPLE)


def _part(request: Request, query: ListQuery, found: Sequence[RowT]) -> tuple[tuple[RowT, ...], int | None]:
    """Return the rows of a list that are asked for, and the offset of those behind them."""
    end = query.offset + _limit(request, query)
    return tuple(found[query.offset : end]), end if len(found) > end else None


def _list(request: Request, query: ListQuery, answer: Any) -> dict[str, Any]:  # noqa: ANN401 - a part of any list
    """Return what the page of a list shows: the part, its filters, and where it goes on."""
    following = None if answer.next is None else address(request.url.path, **_said(query), offset=answer.next)
    return {"answer": answer, "query": query, "following": following}


def _said(query: ListQuery) -> dict[str, Any]:
    return {name: value for name, value in msgspec.to_builtins(query).items() if name != "offset"}


def vehicle(request: Request) -> Response:
    """Tell of one vehicle: its clutches now, how far their fluid will go, and their past."""
    query, sources = asked(request, VehicleQuery), sources_of(request)
    name, engine, snapshot = query.vehicle, sources.engine, sources.keeper.snapshot
    about = queries.vehicle_of(engine, name)
    if about is None:
        raise NotFoundError(f"no message was ever received of a vehicle {name}")
    own, fills, stored = (
        snapshot.vehicles.get(name, ()),
        queries.fills_of(engine, name),
        queries.stored_of(engine, name),
    )
    pasts = [read_past(engine, now, fills, query.service_km * M_PER_KM) for now in own]
    estimates = [one for past in pasts for one in past.estimates]
    answer = VehicleAnswer(
        vehicle=name,
        is_online=None if about["is_online"] is None else bool(about["is_online"]),
        connected_at=about["connected_at"],
        last_result_at=max((at for _, at in stored.values() if at is not None), default=None),
        service_version=about["service_version"],
        action=own[0].action if own else None,
        order=own[0].order if own else None,
        outlook=outlook_text((past.prognosis for past in pasts), own[0]) if own else None,
        fills=fills,
        alarms=tuple(Alarm(**one) for one in book.alarms(engine, ALARM.c.vehicle == name)),
        clutches=tuple(
            ClutchHistory(
                now=now,
                outlook=outlook_answer(past),
                why_no_outlook=NO_PROGNOSIS if past.prognosis is None else None,
                trend=past.trend,
                result_count=stored.get(now.clutch, (0, None))[0],
            )
            for now, past in zip(own, pasts, strict=True)
        ),
        changes=tuple(courses(estimates)),
        loads=tuple(loads(estimates)),
        causes=_causes(request, own),
    )
    if is_api(request):
        return encoded(answer)
    fan = fan_of_vehicle(own, pasts, fills, answer.alarms) if own else None
    shown = {
        "answer": answer,
        "fan": fan,
        "fan_picture": "" if fan is None else fan_picture(fan),
        "fan_record": None if fan is None else fan_record(fan),
        "left": _left(answer, [past.prognosis for past in pasts if past.prognosis is not None]),
        "steps": STEPS.get(Action(answer.action), ()) if answer.action else (),
        "happened": sorted(_happened(answer), key=lambda one: one[0], reverse=True),
        "lines": course_lines(answer.changes),
        "assumptions": dict.fromkeys(
            one for each in answer.clutches if each.outlook for one in each.outlook.assumptions
        ),
        "now": sources.now(),
    }
    return page(request, "vehicle.html", shown)


def _left(answer: VehicleAnswer, foretold: Sequence[Prognosis]) -> dict[str, Any] | None:
    """Return how far the fluid has gone and how far it will go, in words and as parts of 1000; None: not known."""
    first = soonest(foretold) or next((one.change_fluid for one in foretold if one.change_fluid is not None), None)
    driven = [one.now.odometer_m for one in answer.clutches if one.now.odometer_m is not None]
    if first is None or not driven or answer.action in UNFORETOLD:
        return None
    filled_m = answer.fills[-1].odometer_m if answer.fills else None
    age_m = 0.0 if filled_m is None else max(max(driven) - filled_m, 0.0)
    text = "" if filled_m is None else f"Fluid: {age_m / M_PER_KM:,.0f} km old. "
    ends = [age_m + (HORIZON_M if one is None else one) for one in (0.0, first.p10_m, first.p50_m, first.p90_m)]
    parts = [round(1000.0 * one / max(ends[-1], M_PER_KM), 1) for one in ends]
    return {
        "text": text + distance_left(foretold, Action(answer.action or Action.NOTHING)).capitalize(),
        "parts": parts,
    }


def _happened(answer: VehicleAnswer) -> Iterator[tuple[datetime, str, float | None, str | None]]:
    """Yield when what was done to a vehicle or told of it, at which distance, with which note."""
    for fill in answer.fills:
        yield fill.filled_at, f"new fluid: {fill.product}", fill.odometer_m, fill.note
    for one in answer.alarms:
        whose = "" if one.clutch is None else f" of {name_of(one.clutch, one.element)}"
        yield one.raised_at, f"alarm{whose}: {one.reason}", None, None
        if one.acknowledged_at is not None:
            yield one.acknowledged_at, f"alarm{whose} acknowledged by {one.acknowledged_by}", None, one.note
        if one.cleared_at is not None:
            yield one.cleared_at, f"alarm{whose} over", None, None


def _causes(request: Request, clutches: Sequence[ClutchNow]) -> Causes | None:
    """Return why a vehicle is as it is, as its last result says; of an earlier fluid nothing."""
    last = max(clutches, key=lambda one: one.end_at, default=None)
    if last is None or last.condition_reason == UNKNOWN_FLUID:
        return None
    found = queries.shift_of(sources_of(request).engine, last.vehicle, last.stream, last.seq)
    return None if found is None else found.causes


def shift(request: Request) -> Response:
    """Tell of one event of a vehicle: its own estimate, the running one after it, and what its data were worth."""
    query = asked(request, ShiftQuery)
    answer = queries.shift_of(sources_of(request).engine, query.vehicle, query.stream, query.seq)
    if answer is None:
        raise NotFoundError(f"{query.vehicle} has no event {query.seq} in this stream")
    if is_api(request):
        return encoded(answer)
    reference = reference_of(answer.vehicle, answer.calibration_version, answer.clutch)
    told = ((answer.friction, "this event alone"), (answer.running, "all events so far"))
    shown = {
        "answer": answer,
        "figures": [
            (what, curve_picture(answer.clutch, FrictionEstimate(**values), reference, answer.element))
            for values, what in told
            if values is not None and reference is not None
        ],
        "thresholds": THRESHOLD_KEYS,
        "has_reference": reference is not None,
        "quantities": _QUANTITIES,
        "parts": list(_parts(asdict(answer.shift_quality))) if answer.shift_quality is not None else [],
    }
    return page(request, "shift.html", shown)


_QUANTITIES: Final = (
    ("mu_C, at high slip", "mu_c", "std_mu_c", 1.0),
    ("mu_S, at no slip", "mu_s", "std_mu_s", 1.0),
    (f"slope {SLOPE_UNIT}", "slope_s_rad", "std_slope_s_rad", PER_1000_RPM),
)


def _parts(told: Mapping[str, Any]) -> Iterator[tuple[str, float, str, str, str]]:
    """Yield the parts of a score as people read them: name, value, its text, what stands behind ±, unit."""
    for name, value in told.items():
        if (reading := reading_of(told, name)) is not None:
            label, shown, std, unit = reading
            yield label, value, digits(shown), "" if std is None else digits(STDS * std), unit


def alarms(request: Request) -> Response:
    """Tell the alarms that rules raised, the latest first."""
    query = asked(request, AlarmsQuery)
    asked_for = query.offset, _limit(request, query)
    some, following = queries.alarms_of(sources_of(request).engine, *asked_for, state=query.state, rule=query.rule)
    answer = AlarmsAnswer(alarms=some, next=following)
    shown = {"rules": [rule.value for rule in AlarmRule]}
    return encoded(answer) if is_api(request) else page(request, "alarms.html", _list(request, query, answer) | shown)


def alarm(request: Request) -> Response:
    """Tell of one alarm that a rule raised."""
    answer = queries.alarm_of(sources_of(request).engine, **msgspec.structs.asdict(asked(request, AlarmQuery)))
    return encoded(answer) if is_api(request) else page(request, "alarm.html", {"answer": answer})


def maintenance(request: Request) -> Response:
    """Tell when the fluids of the fleet are due, in the order of their days."""
    query, sources = asked(request, ListQuery), sources_of(request)
    keeper, today = sources.keeper, sources.now().date()

    def place(now: ClutchNow) -> tuple[bool, str, int, str, int]:
        """Return where a fluid stands: what is overdue first, then by its day; what has no day is last."""
        is_overdue, day = days_of(now, keeper.foretold(now), today)
        return not is_overdue, (day or date.max).isoformat(), SEVERITY[Severity(now.condition)], now.vehicle, now.clutch

    found = sorted(keeper.snapshot.clutches, key=place)
    some, following = _part(request, query, found)
    dues = tuple(due_of(now, keeper.foretold(now), today) for now in some)
    answer = MaintenanceAnswer(clutches=dues, clutch_count=len(found), next=following)
    if is_api(request):
        return encoded(answer)
    shown = {"weeks": _weeks(dues, today), "lanes": _lanes(keeper, today)}
    return page(request, "maintenance.html", _list(request, query, answer) | shown)


def _lanes(keeper: Keeper, today: date) -> tuple[list[str], list[tuple[str, list[int]]]]:
    """Return the weeks to come, and for each type how many vehicles are due in which; the largest type first."""
    monday = today - timedelta(days=today.weekday())
    mondays = (monday + timedelta(weeks=week) for week in range(1, WEEKS))
    heads = ["now", "this week", *(f"{day:%d %b}" for day in mondays), "later", "no day"]
    lanes: dict[str, list[int]] = {}
    for one in keeper.snapshot.worst:
        is_overdue, day = days_of(one, keeper.foretold(one), today)
        week = WEEKS + 1 if day is None else min((day - monday).days // 7, WEEKS)
        column = 0 if is_overdue or (day is not None and day <= today) else 1 + week
        lanes.setdefault(vehicle_type(one), [0] * len(heads))[column] += 1
    return heads, sorted(lanes.items(), key=lambda lane: (-sum(lane[1]), lane[0]))


def _weeks(dues: Sequence[Due], today: date) -> list[tuple[str, list[Due]]]:
    """Return which vehicles are due by the week from which they are, what is overdue first, what has no day last.

    Both clutches of a vehicle slip in one oil, so it is told once.
    """
    found: dict[str, list[Due]] = {}
    seen: dict[str, Due] = {}
    for one in dues:
        if seen.setdefault(one.vehicle, one) is not one:
            continue
        if one.is_overdue or (one.due_from is not None and one.due_from <= today):
            key = "Now"
        else:
            monday = one.due_from and one.due_from - timedelta(days=one.due_from.weekday())
            key = "No day known" if monday is None else f"Week of {monday.isoformat()}"
        found.setdefault(key, []).append(one)
    return list(found.items())


def _moment(word: str) -> datetime:
    try:
        moment = datetime.fromisoformat(word)
        return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    except (ValueError, OverflowError) as exc:
        raise AskError("no date, such as 2026-01-31 or 2026-01-31T12:00Z") from exc


def quarantine(request: Request) -> Response:
    """Tell which messages could not be used, the latest first."""
    query = asked(request, ListQuery)
    some, following = queries.quarantined(sources_of(request).engine, query.offset, _limit(request, query))
    answer = QuarantineAnswer(messages=some, next=following)
    return encoded(answer) if is_api(request) else page(request, "quarantine.html", _list(request, query, answer))


async def acknowledge(request: Request) -> Response:
    """Acknowledge an alarm, once."""
    form = await form_of(request, Acknowledgement, UserRole.WORKSHOP)
    writer, by = _writer_of(request)

    def write() -> None:
        queries.alarm_of(writer, **key)
        note = Note(**by, at=sources_of(request).now(), text=form.note)
        subject = Subject(vehicle=form.vehicle, clutch=form.clutch, rule=form.rule)
        if not book.acknowledge(writer, subject, form.number, note):
            raise AskError("somebody else has already acknowledged this alarm")

    key: dict[str, Any] = {name: getattr(form, name) for name in ("vehicle", "clutch", "rule", "number")}
    await run_in_threadpool(write)
    return RedirectResponse(address("/alarm", **key), status_code=303)


async def change_fluid(request: Request) -> Response:
    """Note that a vehicle got new fluid, or take a fill back; the same fill is noted once."""
    form = await form_of(request, NewFluid, UserRole.WORKSHOP)
    (writer, by), sources = _writer_of(request), sources_of(request)
    at = None if form.at is None else _moment(form.at)

    def write() -> None:
        if form.undo:
            common.withdraw_fill(writer, form.vehicle, at, **by)
        elif form.product is None:
            raise AskError("product: which fluid is in?")
        else:
            odometer_m = None if form.odometer_km is None else form.odometer_km * M_PER_KM
            told: dict[str, Any] = {"at": at or sources.now(), "odometer_m": odometer_m, "note": form.note}
            common.note_fill(writer, form.vehicle, form.product, **told, **by)

    try:
        await run_in_threadpool(write)
    except (BackendConfigError, UnknownVehicleError) as exc:
        raise AskError(str(exc)) from exc
    await sources.keeper.look()
    return RedirectResponse(address(f"/vehicles/{form.vehicle}"), status_code=303)


def _writer_of(request: Request) -> tuple[Engine, dict[str, Any]]:
    """Return where somebody changes something, and who it is, for the audit."""
    writer, viewer = sources_of(request).writer, viewer_of(request)
    if writer is None or viewer.name is None:
        raise NotFoundError("this server is read-only")
    return writer, {"by": viewer.name, "role": viewer.role.name.lower()}


class Endpoint(NamedTuple):
    """A page, its address for programs, and the records of question and answer."""

    path: str
    api_path: str
    handler: Callable[[Request], Response]
    query: type
    answer: type


ENDPOINTS: Final = (
    Endpoint("/", f"{API}/vehicles", vehicles, VehiclesQuery, VehiclesAnswer),
    Endpoint("/vehicles/{vehicle}", f"{API}/vehicles/{{vehicle}}", vehicle, VehicleQuery, VehicleAnswer),
    Endpoint("/vehicles/{vehicle}/shift", f"{API}/vehicles/{{vehicle}}/shift", shift, ShiftQuery, ShiftAnswer),
    Endpoint("/alarms", f"{API}/alarms", alarms, AlarmsQuery, AlarmsAnswer),
    Endpoint("/alarm", f"{API}/alarm", alarm, AlarmQuery, Alarm),
    Endpoint("/maintenance", f"{API}/maintenance", maintenance, ListQuery, MaintenanceAnswer),
    Endpoint("/quarantine", f"{API}/quarantine", quarantine, ListQuery, QuarantineAnswer),
)
LEFT: Final = ("/clutches", "/changes")  # pages of earlier releases; the list of vehicles stands for them
OPENAPI_PATH: Final = f"{API}/openapi.json"


def routes_of(news: News) -> list[BaseRoute]:
    """Return all routes."""
    content = msgspec.json.encode(openapi())
    return [
        *(Route(path, one.handler) for one in ENDPOINTS for path in (one.path, one.api_path)),
        Route("/alarm/acknowledge", acknowledge, methods=["POST"]),
        Route("/vehicles/{vehicle}/fluid", change_fluid, methods=["POST"]),
        Route(OPENAPI_PATH, lambda _: Response(content, media_type="application/json")),
        Route("/events", news.answer),
        *(Route(path, lambda _: RedirectResponse("/", status_code=301)) for path in LEFT),
        *(Route(API + path, _left_for) for path in LEFT),
        Route(CSV_PATH, vehicles),
        Mount(
            "/static", StaticFiles(packages=[("fleet_backend.page", "static"), ("clutchdiag_io.pages", "templates")])
        ),
    ]


def _left_for(_: Request) -> Response:
    raise HTTPException(410, f"this left: use {API}/vehicles and {API}/vehicles/NAME")


def openapi() -> dict[str, Any]:
    """Return the description of the addresses for programs (OpenAPI 3.1), by the records of questions and answers."""
    template = "#/components/schemas/{name}"
    records = [Problem, *(one.answer for one in ENDPOINTS), *(one.query for one in ENDPOINTS)]
    schemas, components = msgspec.json.schema_components(records, ref_template=template)
    wrong = {"content": {"application/problem+json": {"schema": schemas[0]}}}
    problems = {
        "400": "the request is not valid",
        "401": "nobody is logged in",
        "403": "this takes another role",
        "404": "not found",
        "503": "the database does not answer",
    }
    paths = {}
    for one, schema in zip(ENDPOINTS, schemas[1:], strict=False):
        asking = components[one.query.__name__]
        parameters = [
            {
                "name": name,
                "in": "path" if f"{{{name}}}" in one.api_path else "query",
                "required": name in asking.get("required", ()),
                "description": part.pop("description", ""),
                "schema": part,
            }
            for name, part in ((name, dict(part)) for name, part in asking["properties"].items())
        ]
        good = {"description": one.handler.__doc__, "content": {"application/json": {"schema": schema}}}
        told = {"200": good} | {status: {"description": text, **wrong} for status, text in problems.items()}
        summary = {"operationId": one.handler.__name__, "summary": one.handler.__doc__}
        paths[one.api_path] = {"get": {**summary, "parameters": parameters, "responses": told}}
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "clutchdiag fleet",
            "version": version("clutchdiag"),
            "description": "What the fleet's database knows. SI units, UTC. Within v1 keys are only ever added.",
        },
        "paths": paths,
        "components": {"schemas": components},
    }
