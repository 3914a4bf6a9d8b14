"""All that the page asks its database: the fleet as it is now, the past of a vehicle, what changed, what waits."""

import gc
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from types import MappingProxyType
from typing import Any, Final, TypeVar

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Connection,
    Engine,
    TextualSelect,
    bindparam,
    cast,
    delete,
    func,
    insert,
    literal_column,
    select,
    text,
)

from clutch_results.records import from_plain
from fleet_backend.ageing.calibrations import remember
from fleet_backend.ageing.records import ClutchNow
from fleet_backend.alarms import book
from fleet_backend.database import transaction
from fleet_backend.months import CLUTCH_STREAM, has_partitions
from fleet_backend.office_tables import ALARM, FLUID_DUE
from fleet_backend.queries import PresentFluid, Row, clutch_names, present_fluids, with_orders
from fleet_backend.schema import (
    FLUID_FILL,
    HAPPENED_AT,
    RANKED_AT,
    SHIFT_RESULT,
    VEHICLE,
    WITHDRAWN_FILL,
    UtcDateTime,
)
from fleet_backend.views import LAST_BY_MONTH, LAST_RESULTS, RUNNING_COLUMNS

RecordT = TypeVar("RecordT")
_MOST_NAMES: Final = 500  # of vehicles in one statement


# The view running_condition for some vehicles alone: a database does not carry a list of names into a view by itself.
_RUNNING: Final = f"""
SELECT {RUNNING_COLUMNS}, s.stored_at, s.causes, s.running_since_bus_ns, NULL AS fluid,
  {{happened_at}} AS happened_at, {{score}} AS score
FROM {{source}}
"""  # noqa: S608 - of our own texts
_SCORE_OF_JSON: Final = "CAST(CAST(s.shift_quality AS json) ->> 'score' AS double precision)"


def _statements(where: str) -> Mapping[bool, TextualSelect]:
    """Return the statement for databases that keep results by months, and for others."""
    sources = {True: (LAST_BY_MONTH, _SCORE_OF_JSON), False: (LAST_RESULTS, "json_extract(s.shift_quality, '$.score')")}
    statements: dict[bool, TextualSelect] = {}
    for kind, (form, score) in sources.items():
        source = form.format(where=where, l_at=RANKED_AT["sqlite"].format("l."))
        made = text(_RUNNING.format(source=source, score=score, happened_at=HAPPENED_AT.format("s.")))
        made = made.bindparams(bindparam("vehicles", expanding=True)) if where else made
        statements[kind] = made.columns(end_at=UtcDateTime(), stored_at=UtcDateTime(), happened_at=UtcDateTime())
    return MappingProxyType(statements)


_ALL_CLUTCHES: Final = _statements("")
_SOME_CLUTCHES: Final = _statements("WHERE k.vehicle IN :vehicles")


class DatabaseSource:
    """Reads the fleet as it is now, whole or what is new."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine

    def all_clutches(self) -> Sequence[ClutchNow]:
        """Return the running condition of every clutch of the fleet."""
        gc.disable()  # nothing of it is garbage: looking for some again and again takes a fifth of the time
        try:
            with transaction(self.engine) as connection:
                rows = connection.execute(_ALL_CLUTCHES[has_partitions(self.engine)]).mappings()
                return _clutches(connection, rows, present_fluids(connection))
        finally:
            gc.enable()

    def clutches_of(self, vehicles: Sequence[str]) -> Sequence[ClutchNow]:
        statement, clutches = _SOME_CLUTCHES[has_partitions(self.engine)], list[ClutchNow]()
        with transaction(self.engine) as connection:
            for first in range(0, len(vehicles), _MOST_NAMES):
                names = list(vehicles[first : first + _MOST_NAMES])
                rows = connection.execute(statement, {"vehicles": names}).mappings()
                clutches += _clutches(connection, rows, present_fluids(connection, names))
        return clutches

    def vehicles_with_news(self, since: datetime) -> Sequence[str]:
        """Return the vehicles of which results were stored at or after a moment."""
        streams, results = CLUTCH_STREAM.c, SHIFT_RESULT.c
        statement = (
            select(streams.vehicle).where(streams.last_stored_at >= since)  # a row for thousands of results
            if has_partitions(self.engine)
            else select(results.vehicle).where(results.stored_at >= since)
        ).distinct()
        with transaction(self.engine) as connection:
            return [str(name) for name in connection.execute(statement).scalars()]

    def now(self) -> datetime:
        """Return what time it is where results are stored."""
        with transaction(self.engine) as connection:
            return connection.execute(select(func.current_timestamp(type_=UtcDateTime()))).scalar_one()

    def fluids(self) -> Mapping[str, PresentFluid]:
        """Return the fluid of each vehicle of which a fill is known."""
        with transaction(self.engine) as connection:
            return present_fluids(connection)

    def fills_mark(self) -> tuple[object, ...]:
        """Return what differs once a fluid fill was noted or taken back."""
        with transaction(self.engine) as connection:
            count, latest = connection.execute(select(func.count(), func.max(FLUID_FILL.c.filled_at))).one()
            withdrawn_count = connection.execute(select(func.count()).select_from(WITHDRAWN_FILL)).scalar_one()
        return count, latest, withdrawn_count

    def alarmed(self) -> Sequence[str]:
        """Return the vehicle of each open alarm."""
        with transaction(self.engine) as connection:
            return list(connection.scalars(select(ALARM.c.vehicle).where(ALARM.c.cleared_at.is_(None))))

    def dues(self, since: datetime) -> Sequence[Row]:
        """Return when fluids are due, as far as the watch foretold that at or after a moment."""
        with transaction(self.engine) as connection:
            statement = select(FLUID_DUE).where(FLUID_DUE.c.judged_at >= since)
            return [dict(row) for row in connection.execute(statement).mappings()]


def _clutches(connection: Connection, rows: Iterable[Row], fluids: Mapping[str, PresentFluid]) -> list[ClutchNow]:
    """Return clutches with the orders for their vehicles, and read their calibrations."""
    ordered = with_orders(rows, fluids, clutch_names(connection))
    clutches = [from_plain(row, ClutchNow) for row in ordered]
    remember(connection, ((now.vehicle, now.calibration_version) for now in clutches))
    return clutches


def arrivals_of(engine: Engine) -> dict[str, tuple[datetime, int]]:
    """Return when a result of each vehicle was stored last, by the database's clock, and how many are stored."""
    table, stored_at, count = (
        (CLUTCH_STREAM, CLUTCH_STREAM.c.last_stored_at, cast(func.sum(CLUTCH_STREAM.c.result_count), BigInteger))
        if has_partitions(engine)
        else (SHIFT_RESULT, SHIFT_RESULT.c.stored_at, func.count())
    )
    with transaction(engine) as connection:
        rows = connection.execute(select(table.c.vehicle, func.max(stored_at), count).group_by(table.c.vehicle))
        return {str(vehicle): (at, results) for vehicle, at, results in rows if at is not None}


def keep_dues(engine: Engine, dues: Mapping[str, Sequence[Row]], at: datetime) -> None:
    """Keep when the fluids of vehicles are due, a row per clutch, in the place of what was kept before."""
    waiting = list(dues)
    for first in range(0, len(waiting), _MOST_NAMES):
        names = waiting[first : first + _MOST_NAMES]
        with transaction(engine) as connection:
            connection.execute(delete(FLUID_DUE).where(FLUID_DUE.c.vehicle.in_(names)))
            known = connection.scalars(select(VEHICLE.c.vehicle).where(VEHICLE.c.vehicle.in_(names)))  # not forgotten
            rows = [{**row, "judged_at": at} for name in known for row in dues[name]]
            if rows:
                connection.execute(insert(FLUID_DUE), rows)


def marks_of_judged(engine: Engine) -> dict[str, str]:
    """Return by what each vehicle was judged last, those of the longest ago first."""
    table = FLUID_DUE.c
    statement = select(table.vehicle, table.mark).where(table.mark.is_not(None)).order_by(table.judged_at)
    with transaction(engine) as connection:
        return {str(vehicle): mark for vehicle, mark in connection.execute(statement)}


def vehicle_of(engine: Engine, vehicle: str) -> Row | None:
    """Return what the service of a vehicle said last of itself; None if nothing was ever heard of it."""
    table = VEHICLE.c
    statement = select(table.is_online, table.connected_at, table.service_version).where(table.vehicle == vehicle)
    with transaction(engine) as connection:
        row = connection.execute(statement).mappings().first()
    return None if row is None else dict(row)


def stored_of(engine: Engine, vehicle: str) -> dict[int, tuple[int, datetime]]:
    """Return by clutch how many results are stored, all versions counted, and when the newest happened."""
    table: Any = CLUTCH_STREAM if has_partitions(engine) else SHIFT_RESULT
    count: Any = cast(func.sum(CLUTCH_STREAM.c.result_count), BigInteger)
    at: Any = CLUTCH_STREAM.c.last_at
    if table is SHIFT_RESULT:
        count, at = func.count(), literal_column(RANKED_AT["sqlite"].format(""), UtcDateTime())
    statement = select(table.c.clutch, count, func.max(at)).where(table.c.vehicle == vehicle).group_by(table.c.clutch)
    with transaction(engine) as connection:
        return {clutch: (results, last_at) for clutch, results, last_at in connection.execute(statement)}


def alarms_of(
    engine: Engine, offset: int, limit: int, *, state: str | None, rule: str | None
) -> tuple[list[Row], int | None]:
    """Return some alarms, the latest first, and the offset of those behind them."""
    conditions: list[ColumnElement[bool]] = [] if state == "all" else [ALARM.c.cleared_at.is_(None)]
    if state == "waiting":
        conditions.append(ALARM.c.acknowledged_at.is_(None))
    if rule is not None:
        conditions.append(ALARM.c.rule == rule)
    rows = book.alarms(engine, *conditions, offset=offset, limit=limit + 1)
    return list(rows[:limit]), offset + limit if len(rows) > limit else None
