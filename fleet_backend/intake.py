"""Messages as they came become rows and receipts; what cannot be used becomes poison with a reason."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import Enum, auto
from typing import Final

from fleet_backend.rows import Poison, Row, controller_row, metrics_row, quarantine_row, shift_row, status_row
from fleet_backend.writer import Batch
from fleet_contract import (
    Address,
    Channel,
    ContractError,
    IdentityError,
    MalformedError,
    Outcome,
    Receipt,
    ResultKey,
    TopicError,
    key_of,
    parse_object,
    parse_topic,
    read_message,
)
from fleet_link import Message

INGESTED: Final = (Channel.SHIFT, Channel.STATUS, Channel.METRICS, Channel.CONTROLLER)
IDENTITY_REASON: Final = "identity"  # of the view identity_alarm too
_LONGEST_KEY_PART: Final = 128  # what an acknowledgement can carry


class Kind(Enum):
    """Where a message belongs."""

    SHIFT = auto()
    STATUS = auto()
    METRICS = auto()
    CONTROLLER = auto()
    POISON = auto()


@dataclass(frozen=True, slots=True, kw_only=True)
class Taken:
    """A message that was looked at: the row it becomes and the receipt its sender gets after the commit."""

    message: Message
    kind: Kind
    row: Row
    receipt: Receipt | None = None


def take(message: Message, received_at: datetime) -> Taken:
    """Return what becomes of a message."""
    try:
        incoming = read_message(message.topic, message.payload)
    except ContractError as exc:
        return refuse(message, _reason_of(exc), str(exc), received_at)
    if incoming.address.channel is Channel.STATUS:
        return Taken(message=message, kind=Kind.STATUS, row=status_row(incoming.data))
    if incoming.address.channel is Channel.METRICS:
        return Taken(message=message, kind=Kind.METRICS, row=metrics_row(incoming.data))
    if incoming.address.channel is Channel.CONTROLLER:
        return Taken(message=message, kind=Kind.CONTROLLER, row=controller_row(incoming.data))
    if incoming.address.channel is not Channel.SHIFT:
        return refuse(message, "topic", "nothing that the backend keeps", received_at)
    receipt = Receipt(key=key_of(incoming.data))
    return Taken(message=message, kind=Kind.SHIFT, row=shift_row(incoming.data), receipt=receipt)


def refuse(message: Message, reason: str, detail: str, received_at: datetime) -> Taken:
    """Return a message as poison; its sender hears of it if the message can still be told from others."""
    address = _address(message.topic)
    poison = Poison(
        topic=message.topic,
        vehicle=None if address is None else address.vehicle,
        payload=message.payload,
        reason=reason,
        detail=detail,
    )
    key = None if address is None else _readable_key(address, message.payload)
    receipt = None if key is None else Receipt(key=key, outcome=Outcome.QUARANTINED, reason=f"{reason}: {detail}")
    return Taken(message=message, kind=Kind.POISON, row=quarantine_row(poison, received_at), receipt=receipt)


def batch_of(taken: Iterable[Taken]) -> Batch:
    """Return the rows of messages, sorted into their tables."""
    rows: dict[Kind, list[Row]] = {kind: [] for kind in Kind}
    for item in taken:
        rows[item.kind].append(item.row)
    return Batch(
        shifts=rows[Kind.SHIFT],
        statuses=rows[Kind.STATUS],
        metrics=rows[Kind.METRICS],
        controllers=rows[Kind.CONTROLLER],
        quarantined=rows[Kind.POISON],
    )


def receipts_of(taken: Sequence[Taken]) -> dict[str, list[Receipt]]:
    """Return the receipts of committed messages by the vehicle that gets them."""
    receipts: dict[str, list[Receipt]] = {}
    for item in taken:
        if item.receipt is not None:
            receipts.setdefault(item.receipt.key.vehicle, []).append(item.receipt)
    return receipts


def _reason_of(exc: ContractError) -> str:
    for kind, reason in ((TopicError, "topic"), (MalformedError, "malformed"), (IdentityError, IDENTITY_REASON)):
        if isinstance(exc, kind):
            return reason
    return "schema"


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
