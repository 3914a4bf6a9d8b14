"""Messages become rows and receipts; those that break the contract become rows of the quarantine, with a reason."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from enum import Enum, auto
from types import MappingProxyType
from typing import Any, Final

from fleet_backend.rows import (
    Row,
    calibration_rows,
    controller_row,
    fill_rows,
    metrics_row,
    moment,
    quarantine_row,
    revision_rows,
    shift_row,
    status_row,
)
from fleet_backend.schema import CLOCK_ERROR
from fleet_backend.writer import Batch
from fleet_contract import (
    NEVER,
    Address,
    Channel,
    ContractError,
    MalformedError,
    Outcome,
    Receipt,
    ResultKey,
    bundled_events,
    key_of,
    parse_object,
    parse_topic,
    read_event,
)
from fleet_link import Message

INGESTED: Final = (
    *(Channel.SHIFT, Channel.BUNDLE, Channel.STATUS),
    *(Channel.METRICS, Channel.CONTROLLER, Channel.FLUID),
)
_BUNDLE_END: Final = f"/{Channel.BUNDLE.label}"
FILL_AHEAD: Final = (
    "a fluid fill at {:%Y-%m-%d %H:%M} UTC is yet to come: set the clock of the vehicle, and take the fill back there "
    "(diag-service fluid-changed --undo)"
)
_LONGEST_KEY_PART: Final = 128  # what an acknowledgement can carry


class MessageKind(Enum):
    """Where a message belongs."""

    SHIFT = auto()
    STATUS = auto()
    METRICS = auto()
    CONTROLLER = auto()
    FILLS = auto()
    POISON = auto()
    WITHHELD = auto()  # beyond a quota


@dataclass(frozen=True, slots=True, kw_only=True)
class Received:
    """A message, the rows it becomes, and the receipt its sender gets after the commit.

    Each result of a bundle becomes one, as if it had been sent alone.
    """

    message: Message
    kind: MessageKind
    row: Row  # of several: what is common to them
    fills: Sequence[Row] = ()
    calibrations: Sequence[Row] = ()
    revisions: Sequence[Row] = ()
    receipt: Receipt | None = None


_STATES: Final[Mapping[Channel, tuple[MessageKind, Callable[[Mapping[str, object]], Row], str]]] = MappingProxyType(
    {
        Channel.STATUS: (MessageKind.STATUS, status_row, "connected_at"),
        Channel.METRICS: (MessageKind.METRICS, metrics_row, "metrics_at"),
        Channel.CONTROLLER: (MessageKind.CONTROLLER, controller_row, "controller_at"),
    }
)


def receive_all(message: Message, received_at: datetime) -> list[Received]:
    """Return a message, or each result of a bundle, with its rows."""
    if message.excess is not None:
        return [refuse(message, MalformedError.reason, message.excess, received_at)]
    if not message.topic.endswith(_BUNDLE_END):
        return [receive(message, received_at)]
    try:
        address = Address(vehicle=parse_topic(message.topic).vehicle, channel=Channel.SHIFT)
        events = bundled_events(message.payload)
    except ContractError as exc:
        return [refuse(message, exc.reason, str(exc), received_at)]
    alone = [Message(topic=address.topic, payload=event, packet_id=message.packet_id) for event in events]
    alone[0] = replace(alone[0], unread_bytes=message.unread_bytes)
    return [_receive(event, address, received_at) for event in alone]


def receive(message: Message, received_at: datetime) -> Received:
    """Return a message that is no bundle, with its rows."""
    try:
        address = parse_topic(message.topic)
    except ContractError as exc:
        return refuse(message, exc.reason, str(exc), received_at)
    return _receive(message, address, received_at)


def _receive(message: Message, address: Address, received_at: datetime) -> Received:
    try:
        incoming = read_event(address, message.payload)
    except ContractError as exc:
        return refuse(message, exc.reason, str(exc), received_at)
    channel, data = address.channel, incoming.data
    if channel is Channel.SHIFT and incoming.key is not None:
        row, revisions = shift_row(data), revision_rows(data)
        receipt = Receipt(key=incoming.key)
        return Received(message=message, kind=MessageKind.SHIFT, row=row, revisions=revisions, receipt=receipt)
    if channel in _STATES:
        kind, row_of, name = _STATES[channel]
        row, calibrations = row_of(data), calibration_rows(data) if channel is Channel.STATUS else ()
        at = row[name]
        if isinstance(at, datetime) and at - received_at > CLOCK_ERROR:
            row[name] = received_at  # else it would hold until then, whatever is said after it
        return Received(message=message, kind=kind, row=row, calibrations=calibrations)
    if channel is Channel.FLUID:
        if (ahead := _fill_ahead(data, received_at)) is not None:
            return refuse(message, "clock", FILL_AHEAD.format(ahead), received_at)
        return Received(
            message=message, kind=MessageKind.FILLS, row={"vehicle": data["vehicle"]}, fills=fill_rows(data)
        )
    return refuse(message, "topic", "a kind of message that the backend does not keep", received_at)


def _fill_ahead(data: Mapping[str, Any], received_at: datetime) -> datetime | None:
    """Return the moment of a fill that is yet to come; until then no result would be of the fluid that is in."""
    moments = (moment(fill["filled_at"]) for fill in data["fills"])
    return next((at for at in moments if at - received_at > CLOCK_ERROR), None)


def refuse(message: Message, reason: str, detail: str, received_at: datetime) -> Received:
    """Return a message as poison; its sender hears of it if the message can still be told from others."""
    address = _address(message.topic)
    vehicle, key = (None, None) if address is None else (address.vehicle, _readable_key(address, message.payload))
    row = quarantine_row(
        received_at,
        message.topic,
        vehicle,
        message.payload,
        unread_bytes=message.unread_bytes,
        reason=reason,
        detail=detail,
    )
    receipt = None if key is None else Receipt(key=key, outcome=Outcome.QUARANTINED, reason=f"{reason}: {detail}")
    return Received(message=message, kind=MessageKind.POISON, row=row, receipt=receipt)


def batch_of(received: Sequence[Received]) -> Batch:
    """Return the rows of messages, sorted into their tables."""
    rows: dict[MessageKind, list[Row]] = {kind: [] for kind in MessageKind}
    for item in received:
        rows[item.kind].append(item.row)
    return Batch(
        shifts=rows[MessageKind.SHIFT],
        statuses=[item.row for item in received if item.kind is MessageKind.STATUS and not _is_of_logs(item)],
        calibrations=[row for item in received for row in item.calibrations],
        revisions=[row for item in received for row in item.revisions],
        metrics=rows[MessageKind.METRICS],
        controllers=rows[MessageKind.CONTROLLER],
        fills=[row for item in received for row in item.fills],
        quarantined=rows[MessageKind.POISON],
    )


def receipts_of(received: Sequence[Received]) -> dict[str, list[Receipt]]:
    """Return the receipts of committed messages by the vehicle that gets them."""
    receipts: dict[str, list[Receipt]] = {}
    for item in received:
        if item.receipt is not None:
            receipts.setdefault(item.receipt.key.vehicle, []).append(item.receipt)
    return receipts


def vehicles_there(received: Iterable[Received]) -> tuple[set[str], set[str]]:
    """Return the vehicles that have just come, also those whose logs are analysed, and those that have been there."""
    came = (
        item for item in received if item.kind is MessageKind.STATUS and (item.row["is_online"] or _is_of_logs(item))
    )
    stayed = (item for item in received if item.kind is MessageKind.METRICS)
    return {str(item.row["vehicle"]) for item in came}, {str(item.row["vehicle"]) for item in stayed}


def _is_of_logs(item: Received) -> bool:
    """Return whether the status is that of an analysis, which no service keeps up to date."""
    return item.row["connected_at"] == moment(NEVER)


def _address(topic: str) -> Address | None:
    try:
        return parse_topic(topic)
    except ContractError:
        return None


def _readable_key(address: Address, payload: bytes) -> ResultKey | None:
    """Return the key of a refused result, for the vehicle on whose topic it came."""
    if address.channel is not Channel.SHIFT:
        return None
    try:
        data = parse_object(payload, address.channel.max_bytes).get("data")
        key = key_of({**data, "vehicle": address.vehicle}) if isinstance(data, dict) else None
    except ContractError:
        return None
    if key is None or key.seq < 1:
        return None
    parts = (key.stream, key.algorithm_version, key.calibration_version)
    return key if all(0 < len(part) <= _LONGEST_KEY_PART for part in parts) else None
