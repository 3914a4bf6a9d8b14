"""What the command line reads: the worst clutches, trends, quarantine, fluid fills; a hash of all results."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from difflib import get_close_matches
from hashlib import sha256
from operator import itemgetter
from typing import Any, Final

from sqlalchemy import (
    Connection,
    Engine,
    RowMapping,
    Select,
    TableClause,
    and_,
    column,
    delete,
    func,
    insert,
    literal_column,
    select,
    table,
    update,
)

from fleet_backend.choices import TrendAxis
from fleet_backend.database import transaction
from fleet_backend.errors import BackendConfigError, UnknownVehicleError
from fleet_backend.office_tables import COMMAND_LINE, FLUID_DUE, note_change
from fleet_backend.schema import (
    CLOCK_ERROR,
    CLUTCH,
    FLUID_FILL,
    HAPPENED_AT,
    KEY_COLUMNS,
    QUARANTINE,
    SHIFT_RESULT,
    UNHASHED_COLUMNS,
    VEHICLE,
    WITHDRAWN_FILL,
    UtcDateTime,
)
from fleet_contract import orders
from fleet_contract.orders import SAME_WITHIN, fill_meant, name_of, odometer_complaint

Row = Mapping[str, Any] | RowMapping
# Columns that hold for a clutch whose fluid was changed since; all others are of the earlier fluid.
_KEPT: Final = frozenset({
    *("place", "vehicle", "clutch", "end_at", "happened_at", "stored_at", "odometer_m", "stream", "seq"),
    *("algorithm_version", "calibration_version", "tier"),
})  # fmt: skip
PresentFluid = tuple[datetime, str]  # since when which fluid is in


def present_fluids(connection: Connection, vehicles: Sequence[str] | None = None) -> dict[str, PresentFluid]:
    """Return the fluid of each vehicle of which a fill is known, of all vehicles or of some."""
    table = FLUID_FILL.c
    statement = select(table.vehicle, table.filled_at, table.product).order_by(table.filled_at)
    if vehicles is not None:
        statement = statement.where(table.vehicle.in_(vehicles))
    fills: dict[str, list[PresentFluid]] = {}
    for row in connection.execute(statement):
        fills.setdefault(row.vehicle, []).append((row.filled_at, row.product))
    return {vehicle: orders.distinct(filled, itemgetter(0))[-1] for vehicle, filled in fills.items()}


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
    for vehicle, clutches in by_vehicle.items():
        filled_at, product = fluids.get(vehicle, (None, clutches[0]["fluid"]))
        order = orders.order_of([_finding(row, names) for row in clutches], filled_at)
        order = replace(order, notes=(*order.notes, *_clock_notes(clutches)))
        added = {"action": order.action.value, "order": order.text, "fluid_since": filled_at, "fluid": product}
        for row in clutches:
            record, element = dict(row), names.get((vehicle, row["clutch"]))
            if orders.is_of_earlier_fluid(record["happened_at"], filled_at, since_of(record)):
                record.update(dict.fromkeys(record.keys() - _KEPT), condition=orders.NO_VERDICT, shift_count=0)
                unseen = orders.unseen_since_new(record["clutch"], element)
                record.update(condition_reason=orders.UNKNOWN_FLUID, advice=unseen)
            del record["running_since_bus_ns"], record["happened_at"]
            yield record | added | {"element": element}


def _clock_notes(rows: Iterable[Row]) -> Iterator[str]:
    """Yield that dates of the last results of a vehicle are later than their receipt, if any are."""
    ahead = [row["end_at"] for row in rows if row["end_at"] - row["stored_at"] > CLOCK_ERROR]
    if ahead:
        yield (
            f"The vehicle's clock was wrong: results are dated up to {max(ahead):%Y-%m-%d}, after their receipt; they "
            "count as of that. Set the clock."
        )


def since_of(row: Row) -> datetime | None:
    """Return since when the running estimate of a row has gathered events, if that is before its own drive."""
    since_ns = row["running_since_bus_ns"]
    return None if since_ns is None else orders.EARLIEST + timedelta(microseconds=since_ns // 1000)


def is_alarming_since(connection: Connection, vehicle: str, clutch: int, filled_at: datetime) -> bool:
    """Return whether any result since a fluid fill says that the fluid is to be changed."""
    table = SHIFT_RESULT.c
    is_alarming = (table.vehicle == vehicle, table.clutch == clutch, table.condition == "change_fluid")
    filled_ns = (filled_at - orders.EARLIEST) // timedelta(microseconds=1) * 1000
    happened_at = literal_column(HAPPENED_AT.format("shift_result."), UtcDateTime())
    is_since = (happened_at > filled_at, func.coalesce(table.running_since_bus_ns, filled_ns + 1) > filled_ns)
    return connection.execute(select(table.seq).where(*is_alarming, *is_since).limit(1)).first() is not None


def _finding(row: Row, names: Mapping[tuple[str, int], str]) -> orders.ClutchFinding:
    return orders.ClutchFinding(
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
    """Return the causes in a row that an order may name."""
    likely = [] if causes is None else json.loads(causes)["likely"]
    return tuple(orders.Suspect(cause["cause"], cause["clutch"], cause["probability"]) for cause in likely)


Record = Mapping[str, Any]
SEVERITIES: Final = ("no_verdict", "good", "watch", "change_fluid")
_ROWS_PER_READ: Final = 2000
_CODE: Final = ("code", "failure_type", "text", "status", "states", "snapshots")


# The documented views as tables to select from; migrations create them, docs/fleet.md describes them.
_FRICTION: Final = ("mu_c", "mu_s", "std_mu_c", "std_mu_s")


def _view(name: str, *columns: str) -> TableClause:
    return table(name, *(column(text, UtcDateTime if text.endswith(("_at", "_since")) else None) for text in columns))


FLEET_WORST_FIRST: Final = _view(
    "fleet_worst_first",
    *("place", "vehicle", "clutch", "severity", "condition", "condition_reason", "advice"),
    *("level_ratio", "shift_count"),
    *_FRICTION,
    *("mu_c_low", "mu_c_high", "mu_s_low", "mu_s_high", "slope_s_rad", "slope_low_s_rad", "slope_high_s_rad"),
    *("probability_negative_slope", "odometer_m", "end_at", "happened_at", "fluid", "fluid_since", "stream", "seq"),
    *("algorithm_version", "calibration_version", "tier"),
)

CLUTCH_TREND: Final = _view(
    "clutch_trend",
    *("vehicle", "clutch", "shift_number", "odometer_m", "end_at"),
    *_FRICTION,
    *("random_std_mu_c", "random_std_mu_s", "covariance_mu_c_mu_s", "slope_s_rad", "std_slope_s_rad"),
    *("probability_negative_slope", "quality", "clutch_temperature_k"),
    *("running_mu_c", "running_std_mu_c", "running_mu_s", "running_std_mu_s"),
    *("running_slope_s_rad", "running_std_slope_s_rad", "running_probability_negative_slope"),
    *("condition", "level_ratio", "fluid", "fluid_since", "stream", "seq"),
    *("algorithm_version", "calibration_version", "kind"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class TableHash:
    """What two databases with the same results have in common."""

    row_count: int
    sha256: str


def worst_first(engine: Engine, limit: int | None = None) -> Sequence[Record]:
    """Return the running condition of every clutch, the worst first, with the order for its vehicle, and why."""
    last, result = FLEET_WORST_FIRST.c, SHIFT_RESULT.c
    names = ("vehicle", "stream", "seq", "algorithm_version", "calibration_version")
    made_at = literal_column("fleet_worst_first.produced_at", UtcDateTime())  # leads to one month in PostgreSQL
    same = and_(*(result[name] == last[name] for name in names), result.produced_at == made_at)
    statement = select(FLEET_WORST_FIRST, result.causes, result.running_since_bus_ns, result.stored_at)
    statement = statement.join_from(FLEET_WORST_FIRST, SHIFT_RESULT, same)
    with transaction(engine) as connection:
        rows = connection.execute(statement.order_by(last.place)).mappings()
        clutches = sorted(
            with_orders(rows, present_fluids(connection), clutch_names(connection)),
            key=lambda row: (-SEVERITIES.index(row["condition"]), row["place"]),
        )
    return [
        {
            **row,
            "place": place,
            "severity": SEVERITIES.index(row["condition"]),
            "causes": None if row["causes"] is None else json.loads(row["causes"]),
        }
        for place, row in enumerate(clutches, 1)
    ][:limit]


def distances_of(action: str, end_at: datetime, row: Row | None) -> tuple[float | None, float | None]:
    """Return how far a fluid lasts from the last event on, by its row of the table: with 50 %, and at least (90 %)."""
    if action == orders.Action.CHANGE_NOW:
        return 0.0, 0.0
    if row is None:
        return None, None
    half, a_day_m = row["half_by"], row["distance_a_day_m"]
    left_m = None if half is None or a_day_m is None else max((half - end_at.date()).days, 0) * a_day_m
    return left_m, row["least_left_m"]


def with_distances(engine: Engine, records: Sequence[Row]) -> list[dict[str, Any]]:
    """Return running conditions with how far the fluid lasts, as far as the watch foretold that of what holds now."""
    with transaction(engine) as connection:
        dues: dict[tuple[str, int], Row] = {
            (row["vehicle"], row["clutch"]): row for row in connection.execute(select(FLUID_DUE)).mappings()
        }
    distances = list[dict[str, Any]]()
    for record in records:
        row = dues.get((record["vehicle"], record["clutch"]))
        if row is not None and (row["action"], row["fluid_since"]) != (record["action"], record["fluid_since"]):
            row = None
        left_m, least_m = distances_of(record["action"], record["end_at"], row)
        distances.append({**record, "left_m": left_m, "least_left_m": least_m})
    return distances


def check_vehicle(engine: Engine, vehicle: str) -> None:
    """Raise UnknownVehicleError, with names that are near, unless something came from a vehicle or on its topics."""
    known = select(VEHICLE.c.vehicle).union(select(QUARANTINE.c.vehicle).where(QUARANTINE.c.vehicle.is_not(None)))
    with transaction(engine) as connection:
        names = {str(name) for name in connection.execute(known).scalars()}
    if vehicle in names:
        return
    folded = {name.casefold(): name for name in sorted(names)}
    near = [folded[name] for name in get_close_matches(vehicle.casefold(), folded, n=3)]
    hint = f"did you mean {', '.join(near)}?" if near else "fleet-backend seen lists the known ones"
    raise UnknownVehicleError(f"no vehicle {vehicle} is known; {hint}")


def trend(engine: Engine, vehicle: str, clutch: int, axis: TrendAxis) -> Sequence[Record]:
    """Return the valid estimates of a clutch in the order of an axis; without an odometer none on that axis."""
    table = CLUTCH_TREND
    columns = {TrendAxis.SHIFT: "shift_number", TrendAxis.ODOMETER: "odometer_m", TrendAxis.DATE: "end_at"}
    along = table.c[columns[axis]]
    return _records(
        engine,
        select(table)
        .where(table.c.vehicle == vehicle, table.c.clutch == clutch, along.is_not(None))
        .order_by(along, table.c.shift_number),
    )


def clutch_name(engine: Engine, vehicle: str, clutch: int) -> str:
    with transaction(engine) as connection:
        return name_of(clutch, clutch_names(connection).get((vehicle, clutch)))


def identity_alarms(engine: Engine) -> Sequence[Record]:
    """Return who is pretended to be, as long as nobody has acknowledged it."""
    view = _view("identity_alarm", "vehicle", "raised_at", "last_at", "message_count", "reason")
    return _records(engine, select(view).order_by(view.c.last_at.desc()))


def acknowledge_quarantine(engine: Engine, vehicle: str, *, by: str, at: datetime) -> int:
    """Acknowledge all that was kept aside on a vehicle's topics; return how many messages that were."""
    with transaction(engine) as connection:
        count = connection.execute(
            update(QUARANTINE)
            .where(QUARANTINE.c.vehicle == vehicle, QUARANTINE.c.acknowledged_at.is_(None))
            .values(acknowledged_at=at, acknowledged_by=by)
        ).rowcount
        if count:
            note_change(connection, "acknowledge quarantine", f"{vehicle}: {count} messages", at=at, by=by)
        return count


def quarantined(engine: Engine, limit: int) -> Sequence[Record]:
    """Return what was kept aside, the latest first."""
    order = (QUARANTINE.c.received_at.desc(), QUARANTINE.c.digest)
    return _records(engine, select(QUARANTINE).order_by(*order).limit(limit))


def purge_quarantine(engine: Engine, before: datetime, *, by: str, at: datetime) -> int:
    """Forget what was kept aside before a moment; return how many messages that were."""
    with transaction(engine) as connection:
        count = connection.execute(delete(QUARANTINE).where(QUARANTINE.c.received_at < before)).rowcount
        if count:
            subject = f"{count} messages from before {before:%Y-%m-%d}"
            note_change(connection, "purge quarantine", subject, at=at, by=by)
        return count


def last_seen(engine: Engine) -> Sequence[Record]:
    """Return when each vehicle was heard of, the longest silence first."""
    names = ("vehicle", "is_online", "connected_at", "service_version", "metrics_at", "last_result_at")
    view = _view("last_seen", *names)
    return _records(engine, select(view).order_by(view.c.last_result_at, view.c.vehicle))


def trouble_codes(engine: Engine) -> Sequence[Record]:
    """Return the trouble codes that controllers tell, a record each; a vehicle without any has one record as well."""
    columns = (VEHICLE.c.vehicle, VEHICLE.c.controller, VEHICLE.c.controller_at)
    vehicles = _records(engine, select(*columns).where(VEHICLE.c.controller.is_not(None)).order_by(VEHICLE.c.vehicle))
    records: list[Record] = []
    for row in vehicles:
        report = json.loads(str(row["controller"]))
        head = {"vehicle": row["vehicle"], "read_at": row["controller_at"], "controller": report["controller"]}
        codes = report["codes"] or [dict.fromkeys(_CODE)]
        records += ({**head, **{name: code[name] for name in _CODE}} for code in codes)
    return records


def note_fill(
    engine: Engine,
    vehicle: str,
    product: str,
    *,
    at: datetime,
    odometer_m: float | None,
    note: str | None,
    by: str = "",  # who notes it, for the audit; of what a vehicle told nobody
    role: str = COMMAND_LINE,
    is_insisted: bool = False,
) -> datetime:
    """Note that a vehicle got new fluid, and return since when; UnknownVehicleError if it never spoke.

    Raises
    ------
    ConfigError
        If the fill is known or yet to come, or its odometer does not fit to the results and nobody insists.
    """
    if at - datetime.now(UTC) > SAME_WITHIN:  # until then no result would be of any known fluid
        raise BackendConfigError(f"a fill at {at.isoformat()} is yet to come")
    with transaction(engine) as connection:
        if not _has(connection, _changing(vehicle)):
            raise UnknownVehicleError(f"of vehicle {vehicle} there are no results and no state")
        near = select(FLUID_FILL.c.filled_at).where(
            FLUID_FILL.c.vehicle == vehicle,
            FLUID_FILL.c.filled_at > at - SAME_WITHIN,
            FLUID_FILL.c.filled_at < at + SAME_WITHIN,
        )
        if (known_at := connection.execute(near).scalar()) is not None:
            raise BackendConfigError(
                f"the fill of {vehicle} at {known_at.isoformat()} is noted already; --undo takes it back"
            )
        complaint = odometer_complaint(odometer_m, *_readings(connection, vehicle, at))
        if complaint and not is_insisted:
            raise BackendConfigError(complaint)
        gone = WITHDRAWN_FILL.c
        while _has(connection, select(gone.vehicle).where(gone.vehicle == vehicle, gone.filled_at == at)):
            at += timedelta(microseconds=1)  # a withdrawn fill keeps its moment
        connection.execute(
            insert(FLUID_FILL).values(vehicle=vehicle, filled_at=at, product=product, odometer_m=odometer_m, note=note)
        )
        if by:
            subject = f"{vehicle}: {product} since {at.isoformat()}: {note or ''}"
            note_change(connection, "note fluid fill", subject, at=datetime.now(UTC), by=by, role=role)
    return at


def _changing(vehicle: str) -> Select[tuple[str]]:
    """Return the statement after which others who change the fills of a vehicle wait; its results still come in."""
    return select(VEHICLE.c.vehicle).where(VEHICLE.c.vehicle == vehicle).with_for_update(key_share=True)


def withdraw_fill(engine: Engine, vehicle: str, at: datetime | None, *, by: str, role: str = COMMAND_LINE) -> datetime:
    """Take back the last fill of a vehicle, or the one nearest a moment; return which. ConfigError if there is none."""
    table = FLUID_FILL.c
    with transaction(engine) as connection:
        connection.execute(_changing(vehicle))
        known: Sequence[datetime] = connection.scalars(select(table.filled_at).where(table.vehicle == vehicle)).all()
        meant = fill_meant(known, lambda filled_at: filled_at, at)
        if meant is None:
            raise BackendConfigError(f"no fill of {vehicle} is noted{f' at {at.isoformat()}' if at else ''}")
        gone = [filled_at for filled_at in known if timedelta(0) <= filled_at - meant < SAME_WITHIN]
        connection.execute(insert(WITHDRAWN_FILL), [{"vehicle": vehicle, "filled_at": filled_at} for filled_at in gone])
        connection.execute(delete(FLUID_FILL).where(table.vehicle == vehicle, table.filled_at.in_(gone)))
        subject = f"{vehicle}: {meant.isoformat()}"
        note_change(connection, "withdraw fluid fill", subject, at=datetime.now(UTC), by=by, role=role)
    return meant


def _readings(connection: Connection, vehicle: str, at: datetime) -> Iterator[float | None]:
    """Yield what the odometer read in the last result before a moment, and in the first after it."""
    table = SHIFT_RESULT.c
    known = select(table.odometer_m).where(table.vehicle == vehicle, table.odometer_m.is_not(None)).limit(1)
    for part, order in ((table.end_at <= at, table.end_at.desc()), (table.end_at > at, table.end_at)):
        yield connection.execute(known.where(part).order_by(order)).scalar()


def table_hash(engine: Engine) -> TableHash:
    """Return a hash of all results: every column but when they were stored, rows in the order of their keys."""
    columns = [column for column in SHIFT_RESULT.columns if column.name not in UNHASHED_COLUMNS]
    key = [SHIFT_RESULT.c[name] for name in KEY_COLUMNS]
    order = [*key, SHIFT_RESULT.c.content_digest]
    digest, row_count, last = sha256(), 0, None
    with transaction(engine) as connection:
        statement = select(*key, *columns).order_by(*order).execution_options(yield_per=_ROWS_PER_READ)
        for result in connection.execute(statement):
            result_key, row = tuple(result[: len(key)]), result[len(key) :]
            if result_key == last:  # another content under one key, which another month holds
                continue
            last = result_key
            values = [value.isoformat() if isinstance(value, datetime) else value for value in row]
            digest.update(json.dumps(values).encode() + b"\n")
            row_count += 1
    return TableHash(row_count=row_count, sha256=digest.hexdigest())


def result_count(engine: Engine) -> int:
    """Return how many results are stored, all versions counted."""
    with transaction(engine) as connection:
        return int(connection.execute(select(func.count()).select_from(SHIFT_RESULT)).scalar_one())


def _has(connection: Connection, statement: Select[tuple[str]]) -> bool:
    return connection.execute(statement).first() is not None


def _records(engine: Engine, statement: Select[tuple[object, ...]]) -> Sequence[Record]:
    with transaction(engine) as connection:
        return [dict(row) for row in connection.execute(statement).mappings()]
