"""What became different of a clutch since a moment, and why: new data, another algorithm or calibration, new fluid."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any, Final

from sqlalchemy import Connection, Engine, Select, func, select

from fleet_backend.database import transaction
from fleet_backend.page.records import Change, ClutchNow
from fleet_backend.schema import FLUID_FILL, SHIFT_RESULT

Row = Mapping[str, Any]
_COLUMNS: Final = (
    "condition",
    "running_mu_c",
    "running_std_mu_c",
    "algorithm_version",
    "calibration_version",
    "end_at",
)


def last_before(vehicle: str, clutch: int, since: datetime) -> Select[Any]:
    """Return the statement for the last result of a clutch that was stored before a moment."""
    table = SHIFT_RESULT
    order = (table.c.vehicle, table.c.clutch, table.c.produced_at, table.c.stream, table.c.seq, table.c.version_rank)
    return (
        select(*(table.c[name] for name in _COLUMNS))
        .where(table.c.vehicle == vehicle, table.c.clutch == clutch, table.c.stored_at < since)
        .order_by(*(column.desc() for column in order))
        .limit(1)
    )


def stored_since(vehicle: str, clutch: int, since: datetime) -> Select[Any]:
    """Return the statement that counts the results of a clutch that were stored at or after a moment."""
    table = SHIFT_RESULT
    own = (table.c.vehicle == vehicle, table.c.clutch == clutch, table.c.stored_at >= since)
    return select(func.count()).select_from(table).where(*own)


def changes_of(engine: Engine, clutches: Iterable[ClutchNow], since: datetime) -> tuple[Change, ...]:
    """Return what became different of each clutch."""
    with transaction(engine) as connection:
        return tuple(_change(connection, now, since) for now in clutches)


def _change(connection: Connection, now: ClutchNow, since: datetime) -> Change:
    found = connection.execute(last_before(now.vehicle, now.clutch, since)).mappings().first()
    before: Row | None = None if found is None else dict(found)
    count = int(connection.execute(stored_since(now.vehicle, now.clutch, since)).scalar_one())
    fills: Sequence[str] = ()
    if before is not None:
        table = FLUID_FILL
        own = (table.c.vehicle == now.vehicle, table.c.filled_at > before["end_at"], table.c.filled_at <= now.end_at)
        fills = connection.execute(select(table.c.product).where(*own).order_by(table.c.filled_at)).scalars().all()
    return Change(
        vehicle=now.vehicle,
        clutch=now.clutch,
        condition_before=None if before is None else before["condition"],
        condition=now.condition,
        mu_c_before=None if before is None else before["running_mu_c"],
        std_mu_c_before=None if before is None else before["running_std_mu_c"],
        mu_c=now.mu_c,
        std_mu_c=now.std_mu_c,
        new_result_count=count,
        why=tuple(_reasons(before, now, count, fills)),
    )


def _reasons(before: Row | None, now: ClutchNow, count: int, fills: Sequence[str]) -> Iterator[str]:
    """Yield why a clutch is told to be another than before, what explains most first."""
    if before is None:
        yield "first results of this clutch"
        return
    for name, word in (("algorithm_version", "algorithm"), ("calibration_version", "calibration")):
        was, is_now = before[name], getattr(now, name)
        if was != is_now:
            yield f"new {word}: {was} before, {is_now} now"
    for product in fills:
        yield f"new fluid: {product}"
    if count:
        yield f"new data: {count} result{'' if count == 1 else 's'}"
