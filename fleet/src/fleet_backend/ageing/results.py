"""The results of one clutch as rows of the database, each event once and by its newest version."""

import json
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from functools import cache
from typing import Any, Final, TypeVar

import msgspec
from sqlalchemy import (
    BindParameter,
    Connection,
    Engine,
    Interval,
    Select,
    and_,
    bindparam,
    func,
    literal,
    literal_column,
    or_,
    select,
    tuple_,
)

from clutch_results.event_kinds import ShiftIndices, ShiftQuality
from clutch_results.records import Causes, from_plain, quality_from, quality_record
from fleet_backend import schema
from fleet_backend.ageing.calibrations import remember
from fleet_backend.ageing.records import Fill
from fleet_backend.database import transaction
from fleet_backend.months import has_partitions
from fleet_backend.queries import Row, since_of
from fleet_backend.schema import FLUID_FILL, RANKED_AT, REVISION, SHIFT_RESULT, UtcDateTime
from fleet_contract.orders import EARLIEST, NO_VERDICT, distinct, is_of_earlier_fluid

RecordT = TypeVar("RecordT")


def fills_of(engine: Engine, vehicle: str) -> tuple[Fill, ...]:
    """Return the fluid fills of a vehicle, the earliest first."""
    with transaction(engine) as connection:
        return _fills(connection, vehicle)


def _fills(connection: Connection, vehicle: str) -> tuple[Fill, ...]:
    table = FLUID_FILL.c
    statement = select(table.filled_at, table.odometer_m, table.product, table.note).where(table.vehicle == vehicle)
    rows = connection.execute(statement.order_by(table.filled_at)).mappings()
    return tuple(distinct((Fill(**row) for row in rows), lambda fill: fill.filled_at))


SAME_RATIO: Final = 0.5
MOST_RESULTS: Final = 4000  # of one clutch, the newest; two years of a taxi
_NEAR: Final = literal(timedelta(days=31), Interval())
_NEWER: Final = SHIFT_RESULT.alias("newer")
# What pictures, tables and prognoses are made of; a row has twice as many columns.
_TREND_COLUMNS: Final = (
    *("vehicle", "stream", "seq", "clutch", "number", "kind", "produced_at"),
    *("end_at", "start_bus_ns", "end_bus_ns"),
    *("from_gear", "to_gear", "status", "reasons", "sample_count", "window_s", "chi_square_ratio", "quality"),
    *("sump_temperature_k", "clutch_temperature_k", "slip_energy_j", "duration_s", "odometer_m", "level_ratio"),
    *("condition", "algorithm_version", "calibration_version", *schema.FRICTION_COLUMNS),
    *(schema.RUNNING + name for name in schema.FRICTION_COLUMNS),
    *(schema.SCALE_FREE + name for name in schema.SCALE_FREE_COLUMNS),
    *("shift_quality", "running_since_bus_ns", "element", "tier", "indices"),
)
_UNKNOWN: Final = {  # of a clutch of whose fluid nothing is known
    "condition": NO_VERDICT,
    "level_ratio": None,
    **{name: None for name in _TREND_COLUMNS if name.startswith(schema.RUNNING)},
}
_FRICTION_PREFIXES: Final = ("", schema.RUNNING, schema.SCALE_FREE)
_UNSHOWN: Final = frozenset({  # of an event; friction is shown apart from the columns
    *("version_rank", "content_digest", "produced_at", "start_bus_ns", "end_bus_ns", "running_since_bus_ns"),
    *(prefix + name for prefix in _FRICTION_PREFIXES for name in schema.FRICTION_COLUMNS),
})  # fmt: skip
_SHIFT_COLUMNS: Final = tuple(name for name in SHIFT_RESULT.columns.keys() if name not in _UNSHOWN)  # noqa: SIM118


@cache
def _current_results(*, is_by_month: bool) -> Select[Any]:
    """Return the statement for the newest results of a clutch, of each event the newest version.

    Where results are kept ``is_by_month``, a newer version is looked for only where the newest positions hold several,
    and among those made within a month of the older one: both say when the event ended.
    """
    table = SHIFT_RESULT
    vehicle: BindParameter[str] = bindparam("vehicle")
    of_clutch = (table.c.vehicle == vehicle, table.c.clutch == bindparam("clutch"))
    order = ("vehicle", "clutch", "produced_at", "stream")
    newest_first = [table.c[name].desc() for name in order]
    newer = select(_NEWER.c.seq).where(
        *(_NEWER.c[name] == table.c[name] for name in ("vehicle", "stream", "seq")),
        _NEWER.c.version_rank > table.c.version_rank,
    )
    is_current = ~newer.exists()
    if is_by_month:
        newer = newer.where(_NEWER.c.produced_at.between(table.c.produced_at - _NEAR, table.c.produced_at + _NEAR))
        beyond = select(table.c.produced_at).where(*of_clutch).order_by(*newest_first).offset(MOST_RESULTS).limit(1)
        edge = func.coalesce(beyond.scalar_subquery(), EARLIEST)
        mixed = select(_NEWER.c.stream, _NEWER.c.seq).group_by(_NEWER.c.stream, _NEWER.c.seq).having(func.count() > 1)
        mixed = mixed.where(_NEWER.c.vehicle == vehicle, _NEWER.c.produced_at >= edge - _NEAR)
        is_single = and_(table.c.produced_at >= edge, tuple_(table.c.stream, table.c.seq).not_in(mixed))
        is_current = or_(is_single, ~newer.exists())
    ranked_at = literal_column(
        RANKED_AT["postgresql" if is_by_month else "sqlite"].format("shift_result."), UtcDateTime()
    )
    columns = (*(table.c[name] for name in _TREND_COLUMNS), ranked_at)
    return select(*columns).where(*of_clutch, is_current).order_by(*newest_first).limit(MOST_RESULTS)


def results_of(engine: Engine, vehicle: str, clutch: int) -> list[Row]:
    """Return the newest results of a clutch, the oldest first; an event that came live and in a log counts once."""
    with transaction(engine) as connection:
        names = (*_TREND_COLUMNS, "ranked_at")
        statement = _current_results(is_by_month=has_partitions(engine))
        stored = connection.execute(statement, {"vehicle": vehicle, "clutch": clutch})
        rows = _revised(connection, [dict(zip(names, row, strict=True)) for row in stored])
        rows = _of_own_fluid(rows, [fill.filled_at for fill in _fills(connection, vehicle)])
        remember(connection, {(row["vehicle"], row["calibration_version"]) for row in rows})
    return in_order(_once(rows))


def in_order(rows: Sequence[Row]) -> list[Row]:
    """Return results of one vehicle, the oldest first; inside a stream only ``seq`` tells the order."""
    last: dict[str, datetime] = {}
    for row in rows:
        stream, at = row["stream"], row["ranked_at"]
        if stream not in last or at > last[stream]:
            last[stream] = at
    return sorted(rows, key=lambda row: (last[row["stream"]], row["stream"], row["seq"]))


def _revised(connection: Connection, rows: list[Row]) -> list[Row]:
    """Return results of one vehicle as later ones have judged them."""
    table = REVISION.c
    statement = select(table.clutch, table.end_bus_ns, table.content).order_by(table.stream, table.seq)
    revisions = connection.execute(statement.where(table.vehicle == rows[0]["vehicle"])) if rows else ()
    contents = {(revision.clutch, revision.end_bus_ns): revision.content for revision in revisions}
    latest = ((row, contents.get((row["clutch"], row["end_bus_ns"]))) for row in rows)
    return [row if content is None else {**row, **json.loads(content)} for row, content in latest]


def _of_own_fluid(rows: list[Row], fills: list[datetime]) -> list[Row]:
    """Return results without a running condition that rests on a fluid before their own, whose fill came late."""
    filled = ((row, max((at for at in fills if at < row["end_at"]), default=None)) for row in rows)
    return [
        {**row, **_UNKNOWN} if is_of_earlier_fluid(row["end_at"], filled_at, since_of(row)) else row
        for row, filled_at in filled
    ]


def _once(rows: list[Row]) -> list[Row]:
    """Return results of one clutch without a second one of an event, from another stream; by the bus's time.

    A clutch engages once at a time. Times of a log without a date begin at zero in every drive and tell nothing.
    """
    once: list[Row] = []
    for row in sorted(rows, key=lambda row: (row["start_bus_ns"], row["produced_at"])):
        before = once[-1] if once else None
        if before is not None and row["start_bus_ns"] > schema.DATED_NS and _is_same(before, row):
            if row["produced_at"] < before["produced_at"]:
                once[-1] = row
            continue
        once.append(row)
    return once


def _is_same(first: Row, second: Row) -> bool:
    """Return whether two results of different streams overlap for most of the longer event."""
    shared_ns = min(first["end_bus_ns"], second["end_bus_ns"]) - max(first["start_bus_ns"], second["start_bus_ns"])
    longer_ns = max(row["end_bus_ns"] - row["start_bus_ns"] for row in (first, second))
    return bool(first["stream"] != second["stream"] and shared_ns > SAME_RATIO * longer_ns)


def shift_of(engine: Engine, vehicle: str, stream: str, seq: int) -> dict[str, Any] | None:
    """Return one event by its newest version; None if there is none."""
    table = SHIFT_RESULT.c
    key = and_(table.vehicle == vehicle, table.stream == stream, table.seq == seq)
    with transaction(engine) as connection:
        statement = select(SHIFT_RESULT).where(key).order_by(table.version_rank.desc())
        rows = _revised(connection, [dict(row) for row in connection.execute(statement).mappings()])
        remember(connection, [(vehicle, row["calibration_version"]) for row in rows[:1]])
    if not rows:
        return None
    row, *older = rows
    return {name: row[name] for name in _SHIFT_COLUMNS} | {
        "reasons": words_in(row),
        "friction": friction_in(row, ""),
        "running": friction_in(row, schema.RUNNING),
        "trust_parts": None if row["trust_parts"] is None else json.loads(row["trust_parts"]),
        "shift_quality": None if (quality := quality_in(row)) is None else quality_record(quality),
        "causes": _read(row["causes"], _CAUSES.decode),
        "indices": _read(row["indices"], json.loads),
        "older_versions": [f"{row['algorithm_version']}, {row['calibration_version']}" for row in older],
    }


_CAUSES: Final = msgspec.json.Decoder(Causes)


def friction_in(row: Row, prefix: str) -> dict[str, float] | None:
    """Return the friction in a row: that of the event, or with a prefix the running one."""
    return None if row[prefix + "mu_c"] is None else {name: row[prefix + name] for name in schema.FRICTION_COLUMNS}


def quality_in(row: Row) -> ShiftQuality | None:
    """Return how well the event in a row went, if that is known."""
    return _read(row["shift_quality"], lambda text: quality_from(msgspec.json.decode(text)))


def indices_in(row: Row) -> ShiftIndices | None:
    """Return what speeds and torques tell of the event in a row; None where it is kept what friction they tell."""
    return _read(row["indices"], lambda text: from_plain(msgspec.json.decode(text), ShiftIndices))


def _read(text: str | None, read: Callable[[str], RecordT]) -> RecordT | None:
    """Return the record that a column holds as JSON; None where there is none, or one of another program."""
    try:
        return None if text is None else read(text)
    except ValueError:
        return None


def words_in(row: Row) -> tuple[str, ...]:
    return tuple(str(row["reasons"]).split(",")) if row["reasons"] else ()


def levels_of(engine: Engine, vehicle: str, clutch: int, most: int = 240, every: int = 10) -> tuple[float, ...]:
    """Return some of the newest levels of a clutch against new fluid, the latest last."""
    table = SHIFT_RESULT.c
    statement = select(table.level_ratio).where(table.vehicle == vehicle, table.clutch == clutch)
    order = (table.vehicle.desc(), table.clutch.desc(), table.produced_at.desc(), table.stream.desc())
    with transaction(engine) as connection:
        levels = connection.scalars(statement.order_by(*order).limit(most)).all()
    return tuple(level for level in levels if level is not None)[::every][::-1]
