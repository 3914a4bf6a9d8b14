"""Which fluids are due when: the prognosis in days, as far as is known how much each vehicle is driven."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from typing import Final

from clutchdiag_io.pages.content import NONE, Badge, Cell, Section, Table, TimeCell
from diag_service.diagnosis.prognosis.sentence import soonest
from fleet_backend.page import wording
from fleet_backend.page.asking import AFTER, Ask, Parameter, ParameterType
from fleet_backend.page.clutch_past import Past
from fleet_backend.page.fleet_view import next_of
from fleet_backend.page.listing import part_of
from fleet_backend.page.outlook import outlook_text
from fleet_backend.page.records import ClutchNow, Due, MaintenanceAnswer, TrendPoint
from fleet_backend.page.vehicle_state import state_of
from fleet_backend.page.vehicle_view import SERVICE_KM, past_of
from fleet_backend.page.view import Shown, Sources, View
from fleet_contract.orders import Action

_LONGEST: Final = 75  # bytes of a line, its end not counted
_ESCAPED: Final = str.maketrans({"\\": "\\\\", ";": "\\;", ",": "\\,", "\n": "\\n", "\r": ""})


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """Something on one day; of the same key in a later calendar it takes the place."""

    key: str
    day: date
    title: str
    text: str


def calendar_of(name: str, entries: Iterable[Entry], now: datetime) -> bytes:
    return "".join(_folded(line) for line in _lines(name, entries, now)).encode()


def _lines(name: str, entries: Iterable[Entry], now: datetime) -> Iterator[str]:
    yield from ("BEGIN:VCALENDAR", "VERSION:2.0", "PRODID:-//clutchdiag//fleet//EN", "CALSCALE:GREGORIAN")
    yield f"X-WR-CALNAME:{name.translate(_ESCAPED)}"
    for one in entries:
        yield from ("BEGIN:VEVENT", f"UID:{one.key.translate(_ESCAPED)}")
        yield f"DTSTAMP:{now.astimezone(UTC):%Y%m%dT%H%M%SZ}"
        yield f"DTSTART;VALUE=DATE:{one.day:%Y%m%d}"
        yield f"DTEND;VALUE=DATE:{one.day + timedelta(days=1):%Y%m%d}"
        yield f"SUMMARY:{one.title.translate(_ESCAPED)}"
        yield f"DESCRIPTION:{one.text.translate(_ESCAPED)}"
        yield from ("TRANSP:TRANSPARENT", "END:VEVENT")
    yield "END:VCALENDAR"


def _folded(line: str) -> str:
    """Return a line in pieces of 75 bytes at most; no character is cut."""
    pieces, size = [""], 0
    for character in line:
        width = len(character.encode())
        if size + width > _LONGEST:
            pieces.append(" ")
            size = 1
        pieces[-1] += character
        size += width
    return "\r\n".join(pieces) + "\r\n"


MOST: Final = 200  # each takes a prognosis
LOOKED_BACK: Final = timedelta(days=90)  # over which it is counted how much a vehicle is driven
LEAST: Final = timedelta(days=1)
_HORIZON: Final = timedelta(days=3653)
_WORDS: Final = (
    "Due from: it is 90 % likely that the fluid lasts until this day. 50 % and 90 % due by: it is so likely that the "
    "fluid has to be changed by this day. Days are counted by the distance of the last 90 days."
)
_LIMIT: Final = Parameter(name="limit", text="how many at most", kind=ParameterType.COUNT, most=MOST, default=50)


def find(sources: Sources, ask: Ask) -> MaintenanceAnswer:
    """Return when the fluids of a part of the fleet are due, the worst first."""
    clutches = sources.keeper.snapshot.clutches
    part = part_of(clutches, ask.text("after"), ask.count("limit"))
    return MaintenanceAnswer(
        clutches=by_day(_due(sources, now, ask.now.date()) for now in part.clutches),
        clutch_count=len(clutches),
        next=part.next,
    )


def show(answer: MaintenanceAnswer, ask: Ask, _sources: Sources) -> Shown:
    head = ("vehicle", "clutch", "verdict", "due", "due from", "50 % due by", "90 % due by", "km a day", "what to do")
    table = Table(caption="When fluids are due, by day", head=head, rows=tuple(map(_cells, answer.clutches)))
    texts = (_WORDS,) if answer.clutches else ("No vehicle has been heard from yet.",)
    return Shown(
        title="Maintenance",
        subtitle=f"{len(answer.clutches)} of {answer.clutch_count} clutches",
        sections=(Section(name="due", title="What is due", texts=texts, tables=(table,) if answer.clutches else ()),),
        next=next_of("/maintenance", ask, answer.next),
    )


def calendar(answer: MaintenanceAnswer, ask: Ask) -> bytes:
    """Return the days from which fluids are due, as a calendar."""
    entries = (
        Entry(
            key=f"{one.vehicle}-{one.clutch}@fluid.clutchdiag",
            day=one.due_from,
            title=f"Fluid of {one.vehicle}, clutch {one.clutch}",
            text=one.text,
        )
        for one in answer.clutches
        if one.due_from is not None
    )
    return calendar_of("Fluids of the fleet", entries, ask.now)


def by_day(due: Iterable[Due]) -> tuple[Due, ...]:
    """Return what is due in the order of its days, what is overdue first, what has no day last."""
    return tuple(sorted(due, key=lambda one: (not one.is_overdue, one.due_from or date.max)))


def driven_a_day_m(points: Sequence[TrendPoint]) -> float | None:
    """Return the distance that a vehicle is driven a day, None if it is not known; points come in their order."""
    known = [(one.end_at, one.odometer_m) for one in points if one.odometer_m is not None]
    if not known:
        return None
    last_at, last_m = known[-1]
    first_at, first_m = next(one for one in known if last_at - one[0] <= LOOKED_BACK)
    if last_at - first_at < LEAST or last_m <= first_m:
        return None
    return (last_m - first_m) * (timedelta(days=1) / (last_at - first_at))


def _past(sources: Sources, now: ClutchNow) -> Past:
    state = state_of(sources.engine, now.vehicle)
    if state is None:  # the snapshot knows a vehicle that is not there any more
        return Past(trend=(), prognosis=None, outlook=None, why_no_outlook="No result yet.")
    return past_of(sources, now, state, SERVICE_KM * wording.M_PER_KM)


def _due(sources: Sources, now: ClutchNow, today: date) -> Due:
    found = _past(sources, now)
    a_day_m = driven_a_day_m(found.trend)
    both = [_past(sources, one) for one in sources.keeper.snapshot.vehicles.get(now.vehicle, (now,))]
    reach = soonest(one.prognosis for one in both if one.prognosis is not None)  # both clutches slip in one oil
    quantiles = (None, None, None) if reach is None else (reach.p10_m, reach.p50_m, reach.p90_m)
    days = [_day(now, distance_m, a_day_m) for distance_m in quantiles]
    if now.action == Action.CHANGE_NOW:
        days = [today] * 3
    outlook = outlook_text((one.prognosis for one in both), now.action)
    return Due(
        vehicle=now.vehicle,
        clutch=now.clutch,
        condition=now.condition,
        is_overdue=now.action == Action.CHANGE_NOW or (days[1] is not None and days[1] < today),
        due_from=days[0],
        half_by=days[1],
        most_by=days[2],
        distance_a_day_m=a_day_m,
        text=f"{now.order} {outlook}",
    )


def _day(now: ClutchNow, distance_m: float | None, a_day_m: float | None) -> date | None:
    if distance_m is None or a_day_m is None or distance_m > a_day_m * _HORIZON.days:
        return None
    return (now.end_at + timedelta(days=distance_m / a_day_m)).date()


def _cells(one: Due) -> tuple[Cell, ...]:
    days = (
        NONE if day is None else TimeCell(iso=day.isoformat(), text=day.isoformat())
        for day in (one.due_from, one.half_by, one.most_by)
    )
    return (
        wording.vehicle_link(one.vehicle),
        str(one.clutch),
        wording.badge(one.condition),
        Badge(style="change-fluid", text="overdue") if one.is_overdue else NONE,
        *days,
        wording.km(one.distance_a_day_m),
        one.text,
    )


VIEW: Final = View(
    name="maintenance",
    page_path="/maintenance",
    api_path="/api/v1/maintenance",
    text="When the fluids of the fleet are due: a part has the worst clutches, in the order of their days.",
    parameters=(AFTER, _LIMIT),
    answer=MaintenanceAnswer,
    row=Due,
    find=find,
    show=show,
    rows=lambda answer: answer.clutches,
    calendar=calendar,
)
