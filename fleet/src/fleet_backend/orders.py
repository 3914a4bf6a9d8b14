"""The order for each vehicle by what the database holds: the last result of each clutch, and the fluid that is in."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime, timedelta
from operator import itemgetter
from typing import Any, Final

from sqlalchemy import Connection, RowMapping, func, literal_column, select

from fleet_backend.schema import CLUTCH, FLUID_FILL, HAPPENED_AT, SHIFT_RESULT, UtcDateTime
from fleet_contract import orders

Row = Mapping[str, Any] | RowMapping
# What a row keeps of a clutch whose fluid was changed since: all else is of the earlier one.
_KEPT: Final = frozenset({
    *("place", "vehicle", "clutch", "end_at", "happened_at", "stored_at", "odometer_m", "stream", "seq"),
    *("algorithm_version", "calibration_version"),
})  # fmt: skip
PresentFluid = tuple[datetime, str]  # since when which fluid is in


def present_fluids(connection: Connection, vehicles: Sequence[str] | None = None) -> dict[str, PresentFluid]:
    """Return the fluid of each vehicle of which a fill is known, of all vehicles or of some."""
    table = FLUID_FILL.c
    statement = select(table.vehicle, table.filled_at, table.product).order_by(table.filled_at)
    if vehicles is not None:
        statement = statement.where(table.vehicle.in_(vehicles))
    known: dict[str, list[PresentFluid]] = {}
    for row in connection.execute(statement):
        known.setdefault(row.vehicle, []).append((row.filled_at, row.product))
    return {vehicle: orders.distinct(own, itemgetter(0))[-1] for vehicle, own in known.items()}


def clutch_names(connection: Connection) -> dict[tuple[str, int], str]:
    """Return the names of clutches that are not clutch 1 or 2 of a pair, by vehicle and number."""
    table = CLUTCH.c
    named = select(table.vehicle, table.clutch, table.element).where(table.element.is_not(None))
    return {(row.vehicle, row.clutch): row.element for row in connection.execute(named)}


def with_orders(
    rows: Iterable[Row], fluids: Mapping[str, PresentFluid], names: Mapping[tuple[str, int], str]
) -> Iterator[dict[str, Any]]:
    """Yield the last results of clutches with the order for their vehicle; those of an earlier fluid say nothing."""
    by_vehicle: dict[str, list[Row]] = {}
    for row in rows:
        by_vehicle.setdefault(row["vehicle"], []).append(row)
    for vehicle, own in by_vehicle.items():
        filled_at, product = fluids.get(vehicle, (None, own[0]["fluid"]))
        order = orders.order_of([_finding(row, names) for row in own], filled_at)
        news = {"action": order.action.value, "order": order.text, "fluid_since": filled_at, "fluid": product}
        for row in own:
            told, element = dict(row), names.get((vehicle, row["clutch"]))
            if orders.is_of_earlier_fluid(told["happened_at"], filled_at, since_of(told)):
                told.update(dict.fromkeys(told.keys() - _KEPT), condition=orders.NO_VERDICT, shift_count=0)
                unseen = orders.unseen_since_new(told["clutch"], element)
                told.update(condition_reason=orders.UNKNOWN_FLUID, advice=unseen)
            del told["running_since_bus_ns"], told["happened_at"]
            yield told | news | {"element": element}


def since_of(row: Row) -> datetime | None:
    """Return how far back what a row tells of the running condition goes, if that is beyond its own drive."""
    since_ns = row["running_since_bus_ns"]
    return None if since_ns is None else orders.EARLIEST + timedelta(microseconds=since_ns // 1000)


def is_alarming_since(connection: Connection, vehicle: str, clutch: int, filled_at: datetime) -> bool:
    """Return whether any result since a fluid fill says that the fluid is to be changed."""
    table = SHIFT_RESULT.c
    own = (table.vehicle == vehicle, table.clutch == clutch, table.condition == "change_fluid")
    filled_ns = (filled_at - orders.EARLIEST) // timedelta(microseconds=1) * 1000
    happened_at = literal_column(HAPPENED_AT.format("shift_result."), UtcDateTime())
    is_since = (happened_at > filled_at, func.coalesce(table.running_since_bus_ns, filled_ns + 1) > filled_ns)
    return connection.execute(select(table.seq).where(*own, *is_since).limit(1)).first() is not None


def _finding(row: Row, names: Mapping[tuple[str, int], str]) -> orders.Finding:
    return orders.Finding(
        clutch=row["clutch"],
        condition=row["condition"],
        text=row["advice"],
        reason=row["condition_reason"],
        end_at=row["happened_at"],
        since_at=since_of(row),
        element=names.get((row["vehicle"], row["clutch"])),
        suspects=_suspects(row["causes"]),
    )


def _suspects(causes: str | None) -> tuple[orders.Suspect, ...]:
    """Return the causes that an order may name, by what a row holds of them."""
    told = [] if causes is None else json.loads(causes)["likely"]
    return tuple(orders.Suspect(one["cause"], one["clutch"], one["probability"]) for one in told)
