"""All that the page asks its database: the fleet as it is now, the past of a vehicle, what changed, what waits."""

import gc
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from datetime import datetime, timedelta
from types import MappingProxyType
from typing import Any, Final, TypeVar

from sqlalchemy import (
    BigInteger,
    Connection,
    Engine,
    Interval,
    Select,
    TextualSelect,
    and_,
    bindparam,
    cast,
    delete,
    func,
    insert,
    literal,
    literal_column,
    or_,
    select,
    text,
    tuple_,
)

from clutch_results.records import Causes, ShiftQuality, from_plain
from clutchdiag_io.people import is_dated
from fleet_backend import schema
from fleet_backend.database import transaction
from fleet_backend.errors import NotFoundError
from fleet_backend.months import CLUTCH_STREAM, has_partitions
from fleet_backend.office_tables import ALARM, FLUID_DUE
from fleet_backend.page.calibrations import remember
from fleet_backend.page.records import Alarm, ClutchNow, Fill, Quarantined, ShiftAnswer
from fleet_backend.queries import PresentFluid, Row, clutch_names, present_fluids, since_of, with_orders
from fleet_backend.schema import (
    FLUID_FILL,
    HAPPENED_AT,
    QUARANTINE,
    RANKED_AT,
    REVISION,
    SHIFT_RESULT,
    VEHICLE,
    WITHDRAWN_FILL,
    UtcDateTime,
)
from fleet_backend.views import LAST_BY_MONTH, LAST_RESULTS, RUNNING_COLUMNS
from fleet_contract.orders import EARLIEST, NO_VERDICT, distinct, is_of_earlier_fluid

RecordT = TypeVar("RecordT")
_MOST_NAMES: Final = 500  # of vehicles in one statement


# The view running_condition for some vehicles alone: a database does not carry a list of names into a view by itself.
_RUNNING: Final = f"""
SELECT {RUNNING_COLUMNS}, s.stored_at, s.causes, s.running_since_bus_ns, NULL AS fluid,
  {{happened_at}} AS happened_at, {{score}} AS score
FROM {{source}}
"""  # noqa: S608 - of our own texts
_SCORE_OF_JSON: Final = "CAST(CAST(s.shift_quality AS json) ->> 'score' AS double precision)"
_CLUTCH_NAMES: Final = tuple(field.name for field in fields(ClutchNow))


def _statements(where: str) -> Mapping[bool, TextualSelect]:
    """Return the statement for databases that keep results by months, and for others."""
    sources = {True: (LAST_BY_MONTH, _SCORE_OF_JSON), False: (LAST_RESULTS, "json_extract(s.shift_quality, '$.score')")}
    found: dict[bool, TextualSelect] = {}
    for kind, (form, score) in sources.items():
        source = form.format(where=where, l_at=RANKED_AT["sqlite"].format("l."))
        made = text(_RUNNING.format(source=source, score=score, happened_at=HAPPENED_AT.format("s.")))
        made = made.bindparams(bindparam("vehicles", expanding=True)) if where else made
        found[kind] = made.columns(end_at=UtcDateTime(), stored_at=UtcDateTime(), happened_at=UtcDateTime())
    return MappingProxyType(found)


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
        statement, found = _SOME_CLUTCHES[has_partitions(self.engine)], list[ClutchNow]()
        with transaction(self.engine) as connection:
            for first in range(0, len(vehicles), _MOST_NAMES):
                names = list(vehicles[first : first + _MOST_NAMES])
                rows = connection.execute(statement, {"vehicles": names}).mappings()
                found += _clutches(connection, rows, present_fluids(connection, names))
        return found

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
    """Return clutches, of whose calibrations is known what their vehicles told."""
    told = with_orders(rows, fluids, clutch_names(connection))
    found = [ClutchNow(**{name: row[name] for name in _CLUTCH_NAMES}) for row in told]
    remember(connection, ((one.vehicle, one.calibration_version) for one in found))
    return found


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


def levels_of(engine: Engine, vehicle: str, clutch: int, most: int = 240, every: int = 10) -> tuple[float, ...]:
    """Return some of the newest levels of a clutch against new fluid, the latest last."""
    table = SHIFT_RESULT.c
    statement = select(table.level_ratio).where(table.vehicle == vehicle, table.clutch == clutch)
    order = (table.vehicle.desc(), table.clutch.desc(), table.produced_at.desc(), table.stream.desc())
    with transaction(engine) as connection:
        told = connection.scalars(statement.order_by(*order).limit(most)).all()
    return tuple(one for one in told if one is not None)[::every][::-1]


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


def fills_of(engine: Engine, vehicle: str) -> tuple[Fill, ...]:
    """Return the fluid fills of a vehicle, the earliest first."""
    with transaction(engine) as connection:
        return _fills(connection, vehicle)


def _fills(connection: Connection, vehicle: str) -> tuple[Fill, ...]:
    table = FLUID_FILL.c
    statement = select(table.filled_at, table.odometer_m, table.product, table.note).where(table.vehicle == vehicle)
    rows = connection.execute(statement.order_by(table.filled_at)).mappings()
    return tuple(distinct((Fill(**row) for row in rows), lambda one: one.filled_at))


SAME_RATIO: Final = 0.5
MOST_RESULTS: Final = 4000  # of one clutch, the newest; two years of a taxi
_NEAR: Final = literal(timedelta(days=31), Interval())
_NEWER: Final = SHIFT_RESULT.alias("newer")
# What pictures, tables and prognoses are made of; a row has twice as many columns.
_TREND_COLUMNS: Final = (
    *("vehicle", "stream", "seq", "clutch", "number", "kind", "produced_at", "stored_at"),
    *("end_at", "start_bus_ns", "end_bus_ns"),
    *("from_gear", "to_gear", "status", "reasons", "sample_count", "window_s", "chi_square_ratio", "quality"),
    *("sump_temperature_k", "clutch_temperature_k", "slip_energy_j", "duration_s", "odometer_m", "level_ratio"),
    *("condition", "algorithm_version", "calibration_version", *schema.FRICTION_COLUMNS),
    *(schema.RUNNING + name for name in schema.FRICTION_COLUMNS),
    *(schema.SCALE_FREE + name for name in schema.SCALE_FREE_COLUMNS),
    *("shift_quality", "running_since_bus_ns", "element"),
)
_UNKNOWN: Final = {  # of a clutch of whose fluid nothing is known
    "condition": NO_VERDICT,
    "level_ratio": None,
    **{name: None for name in _TREND_COLUMNS if name.startswith(schema.RUNNING)},
}
_SHIFT_NAMES: Final = tuple(field.name for field in fields(ShiftAnswer))


def current_results(vehicle: str, clutch: int, most: int = MOST_RESULTS, *, is_by_month: bool = False) -> Select[Any]:
    """Return the statement for the newest results of a clutch, of each event the newest version.

    Where results are kept ``is_by_month``, a newer version is looked for only where the newest positions hold several,
    and among those made within a month of the older one: both say when the event ended.
    """
    table = SHIFT_RESULT
    own, order = (table.c.vehicle == vehicle, table.c.clutch == clutch), ("vehicle", "clutch", "produced_at", "stream")
    newest_first = [table.c[name].desc() for name in order]
    newer = select(_NEWER.c.seq).where(
        *(_NEWER.c[name] == table.c[name] for name in ("vehicle", "stream", "seq")),
        _NEWER.c.version_rank > table.c.version_rank,
    )
    is_current = ~newer.exists()
    if is_by_month:
        newer = newer.where(_NEWER.c.produced_at.between(table.c.produced_at - _NEAR, table.c.produced_at + _NEAR))
        beyond = select(table.c.produced_at).where(*own).order_by(*newest_first).offset(most).limit(1)
        edge = func.coalesce(beyond.scalar_subquery(), EARLIEST)
        mixed = select(_NEWER.c.stream, _NEWER.c.seq).group_by(_NEWER.c.stream, _NEWER.c.seq).having(func.count() > 1)
        mixed = mixed.where(_NEWER.c.vehicle == vehicle, _NEWER.c.produced_at >= edge - _NEAR)
        is_single = and_(table.c.produced_at >= edge, tuple_(table.c.stream, table.c.seq).not_in(mixed))
        is_current = or_(is_single, ~newer.exists())
    return (
        select(*(table.c[name] for name in _TREND_COLUMNS)).where(*own, is_current).order_by(*newest_first).limit(most)
    )


def results_of(engine: Engine, vehicle: str, clutch: int) -> list[Row]:
    """Return the newest results of a clutch, the oldest first; what was seen live and in a log counts once."""
    with transaction(engine) as connection:
        statement = current_results(vehicle, clutch, is_by_month=has_partitions(engine))
        found = connection.execute(statement)
        rows = _revised(connection, [dict(zip(_TREND_COLUMNS, row, strict=True)) for row in found])
        rows = _of_own_fluid(rows, [fill.filled_at for fill in _fills(connection, vehicle)])
        remember(connection, {(row["vehicle"], row["calibration_version"]) for row in rows})
    return in_order(_once(rows))


def in_order(rows: Sequence[Row]) -> list[Row]:
    """Return results of one vehicle, the oldest first; inside a stream only ``seq`` tells the order."""
    last: dict[str, datetime] = {}
    for row in rows:  # as databases rank
        at = min(at for at in (row["stored_at"], row["produced_at"], row["end_at"]) if is_dated(at))
        last[row["stream"]] = max(at, last.get(row["stream"], at))
    return sorted(rows, key=lambda row: (last[row["stream"]], row["stream"], row["seq"]))


def _revised(connection: Connection, rows: list[Row]) -> list[Row]:
    """Return results of one vehicle as later ones have judged them."""
    table = REVISION.c
    statement = select(table.clutch, table.end_bus_ns, table.content).order_by(table.stream, table.seq)
    told = connection.execute(statement.where(table.vehicle == rows[0]["vehicle"])) if rows else ()
    now = {(one.clutch, one.end_bus_ns): one.content for one in told}
    known = ((row, now.get((row["clutch"], row["end_bus_ns"]))) for row in rows)
    return [row if content is None else {**row, **json.loads(content)} for row, content in known]


def _of_own_fluid(rows: list[Row], fills: list[datetime]) -> list[Row]:
    """Return results without a running condition that rests on a fluid before their own, whose fill came late."""
    filled = ((row, max((at for at in fills if at < row["end_at"]), default=None)) for row in rows)
    return [
        {**row, **_UNKNOWN} if is_of_earlier_fluid(row["end_at"], filled_at, since_of(row)) else row
        for row, filled_at in filled
    ]


def _once(rows: list[Row]) -> list[Row]:
    """Return results of one clutch without those of events that another stream has told before, by the bus's time.

    A clutch engages once at a time. Times of a log that has no date begin at zero in every drive and tell nothing.
    """
    found: list[Row] = []
    for row in sorted(rows, key=lambda row: (row["start_bus_ns"], row["produced_at"])):
        before = found[-1] if found else None
        if before is not None and row["start_bus_ns"] > schema.DATED_NS and _is_same(before, row):
            if row["produced_at"] < before["produced_at"]:
                found[-1] = row
            continue
        found.append(row)
    return found


def _is_same(one: Row, other: Row) -> bool:
    """Return whether two results of different streams overlap for most of the longer event."""
    shared_ns = min(one["end_bus_ns"], other["end_bus_ns"]) - max(one["start_bus_ns"], other["start_bus_ns"])
    longer_ns = max(row["end_bus_ns"] - row["start_bus_ns"] for row in (one, other))
    return bool(one["stream"] != other["stream"] and shared_ns > SAME_RATIO * longer_ns)


def shift_of(engine: Engine, vehicle: str, stream: str, seq: int) -> ShiftAnswer | None:
    """Return one event by its newest version; None if there is none."""
    table = SHIFT_RESULT.c
    own = and_(table.vehicle == vehicle, table.stream == stream, table.seq == seq)
    with transaction(engine) as connection:
        statement = select(SHIFT_RESULT).where(own).order_by(table.version_rank.desc())
        rows = _revised(connection, [dict(row) for row in connection.execute(statement).mappings()])
        remember(connection, [(vehicle, row["calibration_version"]) for row in rows[:1]])
    if not rows:
        return None
    row = rows[0]
    made: dict[str, Any] = {
        "reasons": words_in(row),
        "friction": friction_in(row, ""),
        "running": friction_in(row, schema.RUNNING),
        "trust_parts": None if row["trust_parts"] is None else json.loads(row["trust_parts"]),
        "shift_quality": record_in(row, "shift_quality", ShiftQuality),
        "causes": record_in(row, "causes", Causes),
        "older_versions": tuple(f"{one['algorithm_version']}, {one['calibration_version']}" for one in rows[1:]),
    }
    return ShiftAnswer(**made, **{name: row[name] for name in _SHIFT_NAMES if name not in made})


def friction_in(row: Row, prefix: str) -> dict[str, float] | None:
    """Return the friction in a row: that of the event, or with a prefix the running one."""
    return None if row[prefix + "mu_c"] is None else {name: row[prefix + name] for name in schema.FRICTION_COLUMNS}


def record_in(row: Row, name: str, kind: type[RecordT]) -> RecordT | None:
    """Return the record that a column holds as JSON; None: nobody told, or not as we understand it."""
    try:
        return None if row[name] is None else from_plain(json.loads(row[name]), kind)
    except ValueError:
        return None


def words_in(row: Row) -> tuple[str, ...]:
    return tuple(str(row["reasons"]).split(",")) if row["reasons"] else ()


_ALARM_NAMES: Final = tuple(field.name for field in fields(Alarm) if field.name != "element")


def alarms_of(
    engine: Engine, offset: int, limit: int, *, state: str | None, rule: str | None
) -> tuple[tuple[Alarm, ...], int | None]:
    """Return some alarms, the latest first, and the offset of those behind them."""
    table = ALARM.c
    statement = select(ALARM).order_by(table.raised_at.desc(), table.vehicle, table.clutch, table.rule, table.number)
    if state != "all":
        statement = statement.where(table.cleared_at.is_(None))
    if state == "waiting":
        statement = statement.where(table.acknowledged_at.is_(None))
    if rule is not None:
        statement = statement.where(table.rule == rule)
    with transaction(engine) as connection:
        names = clutch_names(connection)
        rows = connection.execute(statement.offset(offset).limit(limit + 1)).mappings()
        found = tuple(_alarm(row, names) for row in rows)
    return found[:limit], offset + limit if len(found) > limit else None


def alarm_of(engine: Engine, **key: str | int) -> Alarm:
    """Return one alarm; raises NotFoundError if there is none."""
    with transaction(engine) as connection:
        own = (ALARM.c[name] == value for name, value in key.items())
        row = connection.execute(select(ALARM).where(*own)).mappings().first()
        if row is None:
            raise NotFoundError("there is no such alarm")
        return _alarm(row, clutch_names(connection))


def _alarm(row: Row, names: Mapping[tuple[str, int], str]) -> Alarm:
    values = {name: row[name] for name in _ALARM_NAMES} | {"clutch": row["clutch"] or None}
    return Alarm(**values, element=names.get((row["vehicle"], row["clutch"])))


def quarantined(engine: Engine, offset: int, limit: int) -> tuple[tuple[Quarantined, ...], int | None]:
    """Return some messages that were kept aside, the latest first, and the offset of those behind them."""
    statement = select(QUARANTINE).order_by(QUARANTINE.c.received_at.desc(), QUARANTINE.c.digest)
    with transaction(engine) as connection:
        rows = connection.execute(statement.offset(offset).limit(limit + 1)).mappings()
        found = tuple(Quarantined(**row) for row in rows)
    return found[:limit], offset + limit if len(found) > limit else None
