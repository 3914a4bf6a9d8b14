"""Messages: a record in its CloudEvents envelope on its topic, and back, with everything checked on the way in.

A result has a key that names it everywhere; a receipt says what became of one in the backend. A bundle holds results of
one vehicle that waited together: a batch of CloudEvents in JSON, each as it would have gone alone, packed by zlib.
Whoever unpacks one knows before how much memory that can take, and judges each event alone.
"""

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Final
from urllib.parse import quote

import msgspec

from fleet_contract.errors import IdentityError, MalformedError, SchemaError
from fleet_contract.schema_check import check_data, check_envelope
from fleet_contract.strict_json import JsonObject, dump, parse_object, shown
from fleet_contract.topics import Address, Channel, parse_topic, topic_of

MAX_RECEIPTS: Final = 100  # in one message
NEVER: Final = "1970-01-01T00:00:00.000000Z"  # of a status: of no connection, a log tells what it was judged by
_MAX_REASON: Final = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultKey:
    """The identity of a result; a message with the same key is a repetition."""

    vehicle: str
    stream: str
    seq: int
    algorithm_version: str
    calibration_version: str

    @property
    def text(self) -> str:
        """The key in one line without spaces: the id of its event."""
        parts = (self.stream, str(self.seq), self.algorithm_version, self.calibration_version)
        return "/".join(map(_quoted, (self.vehicle, *parts)))


@lru_cache(maxsize=4096)
def _quoted(part: str) -> str:
    return quote(part, safe="+")


class Outcome(StrEnum):
    """What became of a result; neither is sent again."""

    ACCEPTED = "accepted"  # stored, now or before
    QUARANTINED = "quarantined"  # kept aside as unusable


@dataclass(frozen=True, slots=True, kw_only=True)
class Receipt:
    """The backend's word that a result is on its disk."""

    key: ResultKey
    outcome: Outcome = Outcome.ACCEPTED
    reason: str | None = None  # of a quarantine


def key_of(record: Mapping[str, object]) -> ResultKey:
    """Return the key of a shift result or of an entry of an acknowledgement that names its vehicle.

    Raises
    ------
    SchemaError
        If a part of it is missing or of another type; the rest of the record does not matter.
    """
    try:
        return msgspec.convert(record, ResultKey)
    except msgspec.ValidationError as exc:
        raise SchemaError("a record without the key of a result") from exc


def receipts_of(ack: Mapping[str, object]) -> list[Receipt]:
    """Return the receipts in the data of a checked acknowledgement."""
    vehicle, entries = ack["vehicle"], ack["results"]
    if not isinstance(entries, list):
        raise SchemaError("results must be a list")
    return [
        Receipt(
            key=key_of({**entry, "vehicle": vehicle}),
            outcome=Outcome(str(entry["outcome"])),
            reason=None if entry.get("reason") is None else str(entry["reason"]),
        )
        for entry in entries
    ]


def takes_bundles(ack: Mapping[str, object]) -> bool:
    """Return whether the backend that wrote a checked acknowledgement takes bundles; earlier ones do not say."""
    return ack.get("takes_bundles") is True


SPEC_VERSION: Final = "1.0"
MAX_FILLS: Final = 256  # in one message; the life of a car has fewer


@dataclass(frozen=True, slots=True, kw_only=True)
class Outgoing:
    """A message ready for a broker; send it with QoS 1."""

    topic: str
    payload: bytes
    is_retained: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Incoming:
    """A message that kept every rule of the contract."""

    address: Address
    event_id: str
    source: str
    time: str  # ISO 8601 UTC
    data: JsonObject
    key: ResultKey | None = None  # of a result or the state after it


def read_message(topic: str, payload: bytes) -> Incoming:
    """Return what a message says.

    Raises
    ------
    TopicError
        If the topic is not one of the contract.
    MalformedError
        If the payload is too long, too deep or not the JSON it should be; a bundle holds several messages, and is none.
    SchemaError
        If envelope or data are not what their schemas describe.
    IdentityError
        If the data are of another vehicle, clutch or key than topic and envelope say.
    """
    return read_event(parse_topic(topic), payload)


def read_event(address: Address, payload: bytes) -> Incoming:
    """Return what an event says that came on the topic of an address, or in a bundle; raises as `read_message` does."""
    if address.channel is Channel.BUNDLE:
        raise MalformedError("a bundle in place of a single message")
    event = parse_object(payload, address.channel.max_bytes)
    check_envelope(event)
    data = event["data"]
    if not isinstance(data, dict):  # the envelope's schema says so too
        raise IdentityError("an event without data")
    check_data(address.channel, data)
    return Incoming(
        address=address,
        event_id=str(event["id"]),
        source=str(event["source"]),
        time=str(event["time"]),
        data=data,
        key=_checked_key(address, event, data),
    )


def shift_message(record: Mapping[str, object]) -> Outgoing:
    return raw_shift_message(key_of(record), _time(record), dump(record))


def raw_shift_message(key: ResultKey, produced_at: str, text: str) -> Outgoing:
    """Return the message of a shift result whose JSON exists already."""
    return _outgoing(
        Channel.SHIFT, key.vehicle, text, source=f"{key.vehicle}/{key.stream}", event_id=key.text, time=produced_at
    )


def clutch_message(record: Mapping[str, object]) -> Outgoing:
    key, clutch = key_of(record), int(str(record["clutch"]))
    source = f"{key.vehicle}/{key.stream}/clutch/{clutch}"
    return _outgoing(
        Channel.CLUTCH, key.vehicle, dump(record), source=source, event_id=key.text, time=_time(record), clutch=clutch
    )


def status_message(record: Mapping[str, object]) -> Outgoing:
    vehicle, time = str(record["vehicle"]), str(record["connected_at"])
    event_id = f"status/{time}/{record['status']}"
    return _outgoing(Channel.STATUS, vehicle, dump(record), source=vehicle, event_id=event_id, time=time)


def metrics_message(vehicle: str, produced_at: str, metrics: Mapping[str, float]) -> Outgoing:
    """Return the message of the numbers of a running service."""
    return _state_message(Channel.METRICS, vehicle, produced_at, {"metrics": dict(metrics)})


def config_message(vehicle: str, produced_at: str, settings: Mapping[str, str | float | bool | None]) -> Outgoing:
    """Return the message of what a service runs with; the caller has masked the secrets."""
    return _state_message(Channel.CONFIG, vehicle, produced_at, {"settings": dict(settings)})


def controller_message(record: Mapping[str, object]) -> Outgoing:
    """Return the message of what a controller says of its trouble codes."""
    vehicle, time = str(record["vehicle"]), _time(record)
    return _outgoing(
        Channel.CONTROLLER, vehicle, dump(record), source=vehicle, event_id=f"controller/{time}", time=time
    )


def fluid_message(vehicle: str, produced_at: str, fills: Sequence[JsonObject], *, is_to_vehicle: bool) -> Outgoing:
    """Return the message of all fluid fills that its sender knows, of many the newest.

    The vehicle tells the fleet, and the fleet the vehicle. A fill has ``filled_at``, ``odometer_m``, ``product`` and
    ``note``; the earliest comes first. Of one that ``is_withdrawn`` only the moment is told.
    """
    withdrawn = [fill["filled_at"] for fill in fills if fill.get("is_withdrawn")]
    fills = [fill for fill in fills if not fill.get("is_withdrawn")]
    content: JsonObject = {"fills": fills[-MAX_FILLS:]} | ({"withdrawn": withdrawn[-MAX_FILLS:]} if withdrawn else {})
    return _state_message(Channel.FILLS if is_to_vehicle else Channel.FLUID, vehicle, produced_at, content)


def ack_messages(
    vehicle: str, receipts: Sequence[Receipt], *, sent_at: str, worker: str, takes_bundles: bool = False
) -> Iterator[Outgoing]:
    """Yield the acknowledgements of committed results of one vehicle, ``MAX_RECEIPTS`` at a time.

    Parameters
    ----------
    sent_at :
        ISO 8601 UTC with microseconds; later than the commit.
    worker :
        Name of who committed; no two workers share one, so that ids stay unique.
    takes_bundles :
        Whether the vehicle may send several results in one message.
    """
    more: JsonObject = {"takes_bundles": True} if takes_bundles else {}
    for number, first in enumerate(range(0, len(receipts), MAX_RECEIPTS)):
        entries = [
            {name: value for name, value in msgspec.to_builtins(receipt.key).items() if name != "vehicle"}
            | {"outcome": receipt.outcome.value, "reason": receipt.reason and receipt.reason[:_MAX_REASON]}
            for receipt in receipts[first : first + MAX_RECEIPTS]
        ]
        head: JsonObject = {"schema": Channel.ACK.schema_name, "vehicle": vehicle, "sent_at": sent_at}
        text, event_id = dump({**head, "results": entries, **more}), f"ack/{sent_at}/{number}"
        yield _outgoing(Channel.ACK, vehicle, text, source=f"{worker}/{vehicle}", event_id=event_id, time=sent_at)


def _state_message(channel: Channel, vehicle: str, produced_at: str, content: JsonObject) -> Outgoing:
    """Return the message of what is said of a vehicle at a moment."""
    head: JsonObject = {"schema": channel.schema_name, "vehicle": vehicle, "produced_at": produced_at}
    event_id = f"{channel.label}/{produced_at}"
    return _outgoing(channel, vehicle, dump(head | content), source=vehicle, event_id=event_id, time=produced_at)


def _time(record: Mapping[str, object]) -> str:
    return str(record["produced_at"])


def _outgoing(
    channel: Channel, vehicle: str, data: str, *, source: str, event_id: str, time: str, clutch: int | None = None
) -> Outgoing:
    head = dump(
        {
            "specversion": SPEC_VERSION,
            "id": event_id,
            "source": source,
            "type": channel.event_type,
            "time": time,
            "datacontenttype": "application/json",
            "dataschema": channel.schema_id,
        }
    )
    payload = f'{head[:-1]},"data":{data}}}'.encode()
    return Outgoing(topic=topic_of(vehicle, channel, clutch), payload=payload, is_retained=channel.is_retained)


def _checked_key(address: Address, event: JsonObject, data: JsonObject) -> ResultKey | None:
    """Return the key of a result or a state; raises IdentityError if topic, envelope and data differ."""
    channel = address.channel
    key = key_of(data) if channel is Channel.SHIFT or channel is Channel.CLUTCH else None
    for name, actual, wanted in (
        ("vehicle", data["vehicle"], address.vehicle),
        ("type", event["type"], channel.event_type),
        ("dataschema", event["dataschema"], channel.schema_id),
        ("clutch", data["clutch"] if channel is Channel.CLUTCH else None, address.clutch),
        ("id", event["id"], event["id"] if key is None else key.text),
    ):
        if actual != wanted:
            raise IdentityError(f"{name} is {shown(str(actual))} where {shown(str(wanted))} belongs")
    return key


MAX_BUNDLED: Final = 50  # results of a bundle; twice as many take a tenth less on air
MAX_BUNDLE_BYTES: Final = 262_144  # of the unpacked text
_LEVEL: Final = 6  # of zlib: 9 saves 2 % more, 4 a third of the time and 8 % less
_ARRAY: Final = msgspec.json.Decoder(list[msgspec.Raw])


def bundle_messages(messages: Sequence[Outgoing]) -> Iterator[Outgoing]:
    """Yield messages of results of one vehicle as bundles, in their order; a single message stays as it is."""
    first, text_bytes = 0, 0
    for place, message in enumerate(messages):
        text_bytes += len(message.payload) + 1
        if place - first == MAX_BUNDLED or (place > first and text_bytes >= MAX_BUNDLE_BYTES):
            yield from _packed(messages[first:place])
            first, text_bytes = place, len(message.payload) + 1
    yield from _packed(messages[first:])


def bundled_events(payload: bytes) -> list[bytes]:
    """Return the events of a bundle, each as a message of its own would have been; none is checked yet.

    Raises
    ------
    MalformedError
        If the payload is too long, packed or unpacked, is not packed by zlib, goes on behind its end, or holds no JSON
        array, none or too many events.
    """
    text = _unpacked(payload)
    try:
        events = _ARRAY.decode(text)
    except (msgspec.DecodeError, RecursionError) as exc:
        raise MalformedError(f"a bundle without a JSON array: {shown(str(exc))}") from exc
    if not 1 <= len(events) <= MAX_BUNDLED:
        raise MalformedError(f"a bundle of {len(events)} results, where 1 to {MAX_BUNDLED} belong")
    return [bytes(event) for event in events]


def _packed(messages: Sequence[Outgoing]) -> Iterator[Outgoing]:
    if len(messages) < 2:
        yield from messages
        return
    payload = zlib.compress(b"[" + b",".join(message.payload for message in messages) + b"]", _LEVEL)
    if len(payload) > Channel.BUNDLE.max_bytes:
        middle = len(messages) // 2
        yield from _packed(messages[:middle])
        yield from _packed(messages[middle:])
        return
    vehicle = parse_topic(messages[0].topic).vehicle
    yield Outgoing(topic=topic_of(vehicle, Channel.BUNDLE), payload=payload, is_retained=False)


def _unpacked(payload: bytes) -> bytes:
    """Return the text of a bundle; never takes more memory than the longest one."""
    if len(payload) > Channel.BUNDLE.max_bytes:
        raise MalformedError(f"a bundle of {len(payload)} bytes, more than {Channel.BUNDLE.max_bytes}")
    inflater = zlib.decompressobj()
    try:
        text = inflater.decompress(payload, MAX_BUNDLE_BYTES + 1)
    except zlib.error as exc:
        raise MalformedError(f"a bundle that zlib did not pack: {shown(str(exc))}") from exc
    if len(text) > MAX_BUNDLE_BYTES:
        raise MalformedError(f"a bundle of more than {MAX_BUNDLE_BYTES} bytes when it is unpacked")
    if not inflater.eof or inflater.unused_data:
        raise MalformedError("a bundle that is cut short" if not inflater.eof else "a bundle with bytes behind its end")
    return text
