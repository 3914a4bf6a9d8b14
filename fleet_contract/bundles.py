"""Bundles: shift results of one vehicle that waited together, in one packed message.

The text is a batch of CloudEvents in JSON, each event as it would have gone alone; zlib packs it. Whoever unpacks one
knows before how much memory that can take, and judges each event alone.
"""

import zlib
from collections.abc import Iterator, Sequence
from typing import Final

import msgspec

from fleet_contract.errors import MalformedError
from fleet_contract.messages import Outgoing
from fleet_contract.strict_json import shown
from fleet_contract.topics import Channel, parse_topic, topic_of

MAX_BUNDLED: Final = 50  # results of a bundle; twice as many take a tenth less on air
MAX_BUNDLE_BYTES: Final = 262_144  # of the unpacked text
_LEVEL: Final = 6  # of zlib: 9 saves 2 % more, 4 a third of the time and 8 % less
_ARRAY: Final = msgspec.json.Decoder(list[msgspec.Raw])


def bundle_messages(messages: Sequence[Outgoing]) -> Iterator[Outgoing]:
    """Yield messages of results of one vehicle in bundles, in their order; one that is left alone stays as it is."""
    first, text_bytes = 0, 0
    for place, message in enumerate(messages):
        text_bytes += len(message.payload) + 1
        if place - first == MAX_BUNDLED or (place > first and text_bytes >= MAX_BUNDLE_BYTES):
            yield from _packed(messages[first:place])
            first, text_bytes = place, len(message.payload) + 1
    yield from _packed(messages[first:])


def bundled_events(payload: bytes) -> list[bytes]:
    """Return the events of a bundle as they would have come alone; nothing is known of them yet.

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
