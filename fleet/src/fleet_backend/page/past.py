"""The past of one vehicle, and one of its events: read from the database by its indexes."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from datetime import datetime, timedelta
from typing import Any, Final, TypeVar

from sqlalchemy import Connection, Engine, Interval, Select, and_, func, literal, or_, select, tuple_

from clutch_results.records import Causes, ShiftQuality, from_plain
from clutchdiag_io.people import is_dated
from fleet_backend import schema
from fleet_backend.database import transaction
from fleet_backend.months import has_partitions
from fleet_backend.page.calibrations import remember
from fleet_backend.page.records import ShiftAnswer
from fleet_backend.page.vehicle_state import fills_in
from fleet_backend.queries import since_of
from fleet_contract.orders import EARLIEST, NO_VERDICT, is_of_earlier_fluid

SAME_RATIO: Final = 0.5
MOST_RESULTS: Final = 4000  # of one clutch, the newest; two years of a taxi
_NEAR: Final = literal(timedelta(days=31), Interval())
_NEWER: Final = schema.SHIFT_RESULT.alias("newer")
# What pictures, tables and prognoses are made of; a row has twice as many columns.
_TREND_COLUMNS: Final = (
    *("vehicle", "stream", "seq", "clutch", "number", "kind", "produced_at", "stored_at"),
    *("end_at", "start_bus_ns", "end_bus_ns"),
    *("from_gear", "to_gear", "status", "reasons", "sample_count", "window_s", "chi_square_ratio", "quality"),
    *("sump_temperature_k", "clutch_temperature_k", "slip_energy_j", "duration_s", "odometer_m", "level_ratio"),
    *("condition", "algorithm_version", "calibration_version", *schema.FRICTION_COLUMNS),
    *(schema.RUNNING + name for name in ("mu_c", "std_mu_c", "mu_s", "std_mu_s", "correlation")),
    *(schema.SCALE_FREE + name for name in schema.SCALE_FREE_COLUMNS),
    *("shift_quality", "running_since_bus_ns"),
)
_UNKNOWN: Final = {  # of a clutch of whose fluid nothing is known
    "condition": NO_VERDICT,
    "level_ratio": None,
    **{name: None for name in _TREND_COLUMNS if name.startswith(schema.RUNNING)},
}
_SHIFT_NAMES: Final = tuple(field.name for field in fields(ShiftAnswer))
RecordT = TypeVar("RecordT")
Row = Mapping[str, Any]  # of any table: what a column holds is the schema's matter


def current_results(vehicle: str, clutch: int, most: int = MOST_RESULTS, *, is_by_month: bool = False) -> Select[Any]:
    """Return the statement for the newest results of a clutch, of each event the newest version.

    Where results are kept ``is_by_month``, a newer version is looked for only where the newest positions hold several,
    and among those made within a month of the older one: both say when the event ended.
    """
    table = schema.SHIFT_RESULT
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
    """Return the newest results of a clutch, the oldest first; inside a stream only ``seq`` tells the order.

    What was seen live and in a log counts once.
    """
    with transaction(engine) as connection:
        statement = current_results(vehicle, clutch, is_by_month=has_partitions(engine))
        found = connection.execute(statement)
        rows = _revised(connection, [dict(zip(_TREND_COLUMNS, row, strict=True)) for row in found])
        rows = _of_own_fluid(rows, [fill.filled_at for fill in fills_in(connection, vehicle)])
        remember(connection, {(row["vehicle"], row["calibration_version"]) for row in rows})
    last: dict[str, datetime] = {}
    for row in rows:
        at = min(
            at for at in (row["stored_at"], row["produced_at"], row["end_at"]) if is_dated(at)
        )  # as databases rank
        last[row["stream"]] = max(at, last.get(row["stream"], at))
    return sorted(_once(rows), key=lambda row: (last[row["stream"]], row["stream"], row["seq"]))


def _revised(connection: Connection, rows: list[Row]) -> list[Row]:
    """Return results of one vehicle as later ones have judged them."""
    table = schema.REVISION.c
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
    table = schema.SHIFT_RESULT
    own = and_(table.c.vehicle == vehicle, table.c.stream == stream, table.c.seq == seq)
    with transaction(engine) as connection:
        statement = select(table).where(own).order_by(table.c.version_rank.desc())
        rows = _revised(connection, [dict(row) for row in connection.execute(statement).mappings()])
        remember(connection, [(vehicle, row["calibration_version"]) for row in rows[:1]])
    if not rows:
        return None
    return _shift(rows[0], rows[1:])


def friction_in(row: Row, prefix: str) -> dict[str, float] | None:
    """Return the friction in a row: that of the event, or with a prefix the running one."""
    if row[prefix + "mu_c"] is None:
        return None
    return {name: row[prefix + name] for name in schema.FRICTION_COLUMNS}


def record_in(row: Row, name: str, kind: type[RecordT]) -> RecordT | None:
    """Return the record that a column holds as JSON; None: nobody told, or not as we understand it."""
    try:
        return None if row[name] is None else from_plain(json.loads(row[name]), kind)
    except ValueError:
        return None


def words_in(row: Row) -> tuple[str, ...]:
    return tuple(str(row["reasons"]).split(",")) if row["reasons"] else ()


def _shift(row: Row, older: Sequence[Row]) -> ShiftAnswer:
    parts = None if row["trust_parts"] is None else json.loads(row["trust_parts"])
    made: dict[str, Any] = {
        "reasons": words_in(row),
        "friction": friction_in(row, ""),
        "running": friction_in(row, schema.RUNNING),
        "trust_parts": parts,
        "shift_quality": record_in(row, "shift_quality", ShiftQuality),
        "causes": record_in(row, "causes", Causes),
        "older_versions": tuple(f"{one['algorithm_version']}, {one['calibration_version']}" for one in older),
    }
    made |= {name: row[name] for name in _SHIFT_NAMES if name not in made}
    return ShiftAnswer(**made)
