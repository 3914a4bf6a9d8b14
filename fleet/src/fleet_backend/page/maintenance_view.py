"""Which fluids are due when: the prognosis in days, as far as is known how much each vehicle is driven.

The watch keeps the days that it foretold, so that a fleet of any size is shown in their order; what it has not come to
is foretold here, the worst first.
"""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from datetime import date, datetime, timedelta
from typing import Final

from sqlalchemy import Engine, delete, func, insert, select

from clutch_results.prognosis import Prognosis
from clutch_results.prognosis.sentence import soonest
from clutchdiag_io.pages.content import NONE, Badge, Cell, Section, Table, TimeCell
from clutchdiag_io.people import is_dated
from fleet_backend.database import transaction
from fleet_backend.office_tables import FLUID_DUE
from fleet_backend.page import wording
from fleet_backend.page.asking import AFTER, Ask, Parameter, ParameterType
from fleet_backend.page.clutches_view import next_of
from fleet_backend.page.listing import SEVERITY, page_of, read_words
from fleet_backend.page.outlook import Past, outlook_text
from fleet_backend.page.records import ClutchNow, Due, MaintenanceAnswer, Severity
from fleet_backend.page.vehicle_state import state_of
from fleet_backend.page.vehicle_view import SERVICE_KM, past_of
from fleet_backend.page.view import Shown, Sources, View
from fleet_backend.schema import VEHICLE
from fleet_contract.orders import Action

MOST: Final = 200
FORETOLD_HERE: Final = 10  # clutches: each takes a prognosis, 0.1 s, and somebody waits; the watch makes the others
READ_HERE: Final = 2_000  # results, after which no other vehicle is foretold: each takes 0.1 ms
LOOKED_BACK: Final = timedelta(days=90)  # over which it is counted how much a vehicle is driven
LEAST: Final = timedelta(days=1)
_HORIZON: Final = timedelta(days=3653)
_WORDS: Final = (
    "Due from: it is 90 % likely that the fluid lasts until this day. 50 % and 90 % due by: it is so likely that the "
    "fluid has to be changed by this day. Days are counted by the distance of the last 90 days."
)
NOT_YET: Final = "Not foretold yet: fleet-backend watch does so."
_PLACE: Final = (bool, str, int, str, int)  # sorts what is due
_LIMIT: Final = Parameter(name="limit", text="how many at most", kind=ParameterType.COUNT, most=MOST, default=50)


def find(sources: Sources, ask: Ask) -> MaintenanceAnswer:
    """Return when the fluids of a part of the fleet are due, by day."""
    snapshot, today, after, limit = sources.keeper.snapshot, ask.now.date(), ask.text("after"), ask.count("limit")
    with transaction(sources.engine) as connection:
        kept = connection.execute(select(func.count(), func.max(FLUID_DUE.c.judged_at))).one()
    due = sources.dues.of("", (snapshot.number, *kept, today), lambda: by_day(_all_due(sources, today)))
    first = 0 if after is None else bisect_right(due, tuple(read_words(after, _PLACE)), key=_place)
    some, following = page_of(due[first : first + limit + 1], limit, _place)
    return MaintenanceAnswer(clutches=some, clutch_count=len(due), next=following)


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


def by_day(due: Iterable[Due]) -> tuple[Due, ...]:
    """Return what is due in the order of its days, what is overdue first, what has no day last, the worst first."""
    return tuple(sorted(due, key=_place))


def _place(one: Due) -> tuple[bool, str, int, str, int]:
    day = (one.due_from or date.max).isoformat()
    return not one.is_overdue, day, SEVERITY[Severity(one.condition)], one.vehicle, one.clutch


def driven_a_day_m(readings: Iterable[tuple[datetime, float | None]]) -> float | None:
    """Return the distance that a vehicle is driven a day, None if it is not known; readings come in their order."""
    known = [(at, odometer_m) for at, odometer_m in readings if odometer_m is not None and is_dated(at)]
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


def _all_due(sources: Sources, today: date) -> Iterator[Due]:
    """Yield when each fluid of the fleet is due: as it was kept, or foretold now, or not yet."""
    statement = select(FLUID_DUE)
    with transaction(sources.engine) as connection:
        kept = {(row.vehicle, row.clutch): row for row in connection.execute(statement)}
    pasts: dict[str, dict[int, Past]] = {}  # of vehicles that are foretold now
    foretold_count = read_count = 0
    for now in sources.keeper.snapshot.clutches:
        row = kept.get((now.vehicle, now.clutch))
        if row is not None and (row.action, row.fluid_since) == (now.action, now.fluid_since):
            days = (row.due_from, row.half_by, row.most_by)
            yield _told(now, days, row.distance_a_day_m, row.outlook, today)
        elif foretold_count < FORETOLD_HERE and (now.vehicle in pasts or read_count < READ_HERE):
            foretold_count += 1
            if now.vehicle not in pasts:
                clutches = sources.keeper.snapshot.vehicles.get(now.vehicle, (now,))
                pasts[now.vehicle] = {one.clutch: _past(sources, one) for one in clutches}
                read_count += sum(len(one.trend) for one in pasts[now.vehicle].values())
            readings = [(one.end_at, one.odometer_m) for one in pasts[now.vehicle][now.clutch].trend]
            yield due_of(now, [one.prognosis for one in pasts[now.vehicle].values()], readings, today)
        else:
            yield _told(now, (None, None, None), None, NOT_YET, today)


def due_of(
    now: ClutchNow,
    founds: Sequence[Prognosis | None],
    readings: Iterable[tuple[datetime, float | None]],
    today: date,
) -> Due:
    """Return when a fluid is due by the prognoses of all clutches of its vehicle: they slip in one oil."""
    a_day_m = driven_a_day_m(readings)
    reach = None if now.action == Action.FIND_CAUSE else soonest(one for one in founds if one is not None)
    quantiles = (None, None, None) if reach is None else (reach.p10_m, reach.p50_m, reach.p90_m)
    first, half, most = (_day(now, distance_m, a_day_m) for distance_m in quantiles)
    return _told(now, (first, half, most), a_day_m, outlook_text(founds, now), today)


def keep_due(engine: Engine, clutches: Sequence[ClutchNow], due: Sequence[Due], at: datetime) -> None:
    """Keep when the fluids of one vehicle are due, in the place of what was kept before."""
    names = ("vehicle", "clutch", "due_from", "half_by", "most_by", "distance_a_day_m")
    rows = [
        {name: getattr(one, name) for name in names}
        | {"judged_at": at, "action": now.action, "fluid_since": now.fluid_since}
        | {"outlook": one.text.removeprefix(now.order).lstrip()}
        for now, one in zip(clutches, due, strict=True)
    ]
    with transaction(engine) as connection:
        connection.execute(delete(FLUID_DUE).where(FLUID_DUE.c.vehicle == clutches[0].vehicle))
        if connection.execute(select(VEHICLE.c.vehicle).where(VEHICLE.c.vehicle == clutches[0].vehicle)).first():
            connection.execute(insert(FLUID_DUE), rows)  # else it was forgotten meanwhile


def _told(
    now: ClutchNow, days: tuple[date | None, date | None, date | None], a_day_m: float | None, outlook: str, today: date
) -> Due:
    first, half, most = (today, today, today) if now.action == Action.CHANGE_NOW else days
    return Due(
        vehicle=now.vehicle,
        clutch=now.clutch,
        element=now.element,
        condition=now.condition,
        is_overdue=now.action == Action.CHANGE_NOW or (half is not None and half < today),
        due_from=first,
        half_by=half,
        most_by=most,
        distance_a_day_m=a_day_m,
        text=f"{now.order} {outlook}",
    )


def _day(now: ClutchNow, distance_m: float | None, a_day_m: float | None) -> date | None:
    if distance_m is None or a_day_m is None or not is_dated(now.end_at) or distance_m > a_day_m * _HORIZON.days:
        return None
    return (now.end_at + timedelta(days=distance_m / a_day_m)).date()


def _cells(one: Due) -> tuple[Cell, ...]:
    days = (
        NONE if day is None else TimeCell(iso=day.isoformat(), text=day.isoformat())
        for day in (one.due_from, one.half_by, one.most_by)
    )
    return (
        wording.vehicle_link(one.vehicle),
        one.element or str(one.clutch),
        wording.badge(one.condition),
        Badge(style="change-fluid", text="overdue") if one.is_overdue else NONE,
        *days,
        wording.km(one.distance_a_day_m),
        one.text,
    )


VIEW: Final = View(
    name="maintenance",
    page_path="/maintenance",
    text="When the fluids of the fleet are due, in the order of their days.",
    parameters=(AFTER, _LIMIT),
    answer=MaintenanceAnswer,
    find=find,
    show=show,
)
