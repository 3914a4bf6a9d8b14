"""The public, versioned JSON of the service: shift results, clutch states, service status.

Within a version keys are only ever added; a reader ignores those it does not know. ``fleet_contract`` holds the JSON
Schemas (2020-12) and the envelope in which records travel. Keys keep one order, so equal results are equal texts.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache
from typing import Final

from clutchdiag_io.files import legible_record
from diag_service.diagnosis.records import ClutchVerdict, Condition, FluidFill, ShiftResult, from_plain, to_plain
from diag_service.errors import ResultError
from fleet_contract import Channel, JsonObject, ResultKey, schema
from fleet_contract.orders import Order

SHIFT_SCHEMA: Final = Channel.SHIFT.schema_name
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_NS_PER_US: Final = 1000
_RESULT_KEYS: Final = ("vehicle", "stream", "seq", "produced_at", "algorithm_version", "calibration_version")
_PUBLIC_NAMES: Final = {"start_ns": "start_bus_ns", "end_ns": "end_bus_ns", "data_quality": "trust"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceStatus:
    """Whether a live service watches a vehicle; retained on the broker, and its last will."""

    vehicle: str
    is_online: bool
    connected_at: str  # ISO 8601 UTC, start of the broker connection that carries this status
    service_version: str
    algorithm_version: str
    calibration_version: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredResult:
    """A row of the outbox: its position in the store, and the record of the result as it is stored."""

    position: int
    key: ResultKey
    clutch: int
    produced_at: str
    text: str  # the JSON of the record


def utc_from_bus_ns(t_ns: int) -> str:
    """Return a bus time as ISO 8601 UTC with microseconds."""
    return iso_utc(_EPOCH + timedelta(microseconds=t_ns // _NS_PER_US))


def iso_utc(moment: datetime) -> str:
    """Return an aware moment as ISO 8601 UTC with microseconds and a final ``Z``."""
    return moment.astimezone(UTC).replace(tzinfo=None).isoformat(timespec="microseconds") + "Z"


def shift_record(result: ShiftResult) -> JsonObject:
    """Return the public form of one shift result, keys in their published order."""
    estimate = to_plain(result.estimate)
    record = estimate | {public: estimate[name] for name, public in _PUBLIC_NAMES.items()}
    record |= {key: getattr(result, key) for key in _RESULT_KEYS}
    record |= {"schema": SHIFT_SCHEMA, "verdict": _verdict_record(result.verdict)}
    record["start_utc"] = utc_from_bus_ns(result.estimate.start_ns)
    record["end_utc"] = utc_from_bus_ns(result.estimate.end_ns)
    return _in_published_order(record, Channel.SHIFT)


def clutch_record(shift: JsonObject, order: Order | None = None) -> JsonObject:
    """Return the state of the clutch after the shift that last engaged it, from the ``shift_record`` of that shift.

    The order is that for the vehicle, the same in the states of both clutches.
    """
    verdict = shift["verdict"]
    if not isinstance(verdict, dict):
        raise ResultError(f"incomplete {SHIFT_SCHEMA} record: no verdict")
    record = {**verdict, **{key: shift[key] for key in (*_RESULT_KEYS, "end_utc")}}
    record["schema"] = Channel.CLUTCH.schema_name
    record |= order_record(order)
    return {key: record.get(key) for key in _keys_of(Channel.CLUTCH)}  # results of older programs lack some


def order_record(order: Order | None) -> JsonObject:
    """Return the order for a vehicle as records hold it."""
    return {"action": None, "order": None} if order is None else {"action": order.action.value, "order": order.text}


def status_record(status: ServiceStatus) -> JsonObject:
    """Return the public form of the service's status."""
    word = "online" if status.is_online else "offline"
    record = {**to_plain(status), "schema": Channel.STATUS.schema_name, "status": word}
    return _in_published_order(record, Channel.STATUS)


def dump(record: Mapping[str, object]) -> str:
    """Return a record as one line of JSON; floats keep every bit.

    Raises
    ------
    ResultError
        If a number is NaN or infinite, which JSON cannot carry.
    """
    try:
        text = json.dumps(record, allow_nan=False, separators=(",", ":"))
        if "\\ud" not in text:
            return text
        return json.dumps(legible_record(record), allow_nan=False, separators=(",", ":"))
    except ValueError as exc:
        raise ResultError(f"a result holds a number that is not finite: {record!r}") from exc


def parse_record(text: str) -> JsonObject:
    """Read back what ``dump(shift_record(...))`` wrote, as a record; raises ResultError if it is none."""
    try:
        record = json.loads(text)
    except ValueError as exc:
        raise ResultError(f"not a shift result: {exc}") from exc
    if not isinstance(record, dict) or record.get("schema") != SHIFT_SCHEMA:
        raise ResultError(f"not a {SHIFT_SCHEMA} record")
    return record


def parse_shift(text: str) -> ShiftResult:
    """Read back what ``dump(shift_record(...))`` wrote; raises ResultError if it is none of this version."""
    return shift_from(parse_record(text))


def shift_from(record: JsonObject) -> ShiftResult:
    """Read back a ``shift_record``, whose schema the caller knows; unknown keys are ignored; raises ResultError."""
    try:
        estimate = record | {name: record.get(public) for name, public in _PUBLIC_NAMES.items()}
        verdict = _condition_as_number(record.get("verdict"))
        return from_plain(record | {"estimate": estimate, "verdict": verdict}, ShiftResult)
    except ValueError as exc:
        raise ResultError(f"incomplete {SHIFT_SCHEMA} record: {exc}") from exc


def verdict_from(table: object) -> ClutchVerdict:
    """Read back the verdict in a ``clutch_record``; raises ResultError if it is none of this version."""
    try:
        return from_plain(_condition_as_number(table), ClutchVerdict)
    except ValueError as exc:
        raise ResultError(f"incomplete {Channel.CLUTCH.schema_name} record: {exc}") from exc


def fill_record(fill: FluidFill) -> JsonObject:
    """Return a fluid fill as it stands in a message; of which vehicle the message says."""
    left_out = {"vehicle"} if fill.is_withdrawn else {"vehicle", "is_withdrawn"}
    return {key: value for key, value in to_plain(fill).items() if key not in left_out}


def fills_from(table: Mapping[str, object]) -> list[FluidFill]:
    """Return the fluid fills in a message, withdrawn ones too; raises ResultError if they are none of this version."""
    fills, withdrawn = table.get("fills"), table.get("withdrawn", [])
    if not isinstance(fills, list) or not isinstance(withdrawn, list):
        raise ResultError("fluid fills are a list")
    fills = [*fills, *({"filled_at": moment, "is_withdrawn": True} for moment in withdrawn)]
    try:
        return [from_plain({**fill, "vehicle": table.get("vehicle")}, FluidFill) for fill in fills]
    except (TypeError, ValueError) as exc:
        raise ResultError(f"incomplete fluid fills: {exc}") from exc


def _verdict_record(verdict: ClutchVerdict) -> JsonObject:
    return to_plain(verdict) | {"condition": verdict.condition.name.lower()}


def _condition_as_number(table: object) -> object:
    """Return the table of a verdict with the number of its condition in place of the public word."""
    if not isinstance(table, dict):
        return table
    return table | {"condition": Condition.__members__.get(str(table.get("condition")).upper())}


def _in_published_order(record: JsonObject, channel: Channel) -> JsonObject:
    return {key: record[key] for key in _keys_of(channel)}


@cache
def _keys_of(channel: Channel) -> tuple[str, ...]:
    """Return the keys of a channel's records in the order in which its schema describes them."""
    properties = schema(channel.label)["properties"]
    return tuple(properties) if isinstance(properties, dict) else ()
