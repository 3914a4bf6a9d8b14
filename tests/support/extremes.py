"""Messages with a number at its bounds, beyond them and far beyond: for each number of each message of the contract."""

import copy
import json
import math
from collections.abc import Iterator
from typing import Any

from jsonschema import Draft202012Validator

from fleet_contract import Channel, Outgoing, key_of, parse_topic, schema
from fleet_contract.messages import SPEC_VERSION
from fleet_contract.topics import topic_of
from tests.golden import messages_v1

Place = tuple[str | int, ...]
FAR = (1e308, -1e308, 1.7e154, 5e-324, -5e-324, 1e-160, 2**63 - 1, -(2**63))
_TEXTS = ("x", "2026-01-01T00:00:00.000000Z", "P0897", "000000", "car1", "a_1")


def golden(channel: Channel) -> dict[str, Any]:
    """Return the data of a stored message of a channel."""
    messages = messages_v1().values()
    return next(
        data
        for one in messages
        if parse_topic(one.topic).channel is channel
        for data in [json.loads(one.payload)["data"]]
    )


def _name(part: dict[str, Any]) -> str:
    """Return a name that an object whose names are its sender's may hold."""
    return str(next(iter(part.get("propertyNames", {}).get("enum", ())), "a_1"))


class Schema:
    """The schema of a channel, and records that have all it describes."""

    def __init__(self, channel: Channel) -> None:
        self.channel = channel
        self._whole: dict[str, Any] = schema(channel.label)
        self.numbers = dict(self._numbers(self._whole, ()))  # by their places
        self.record = self._filled(self._whole, golden(channel))

    def _resolved(self, part: dict[str, Any]) -> dict[str, Any]:
        name = part.get("$ref")
        return part if name is None else self._whole["$defs"][name.rpartition("/")[2]]

    def _numbers(self, part: dict[str, Any], place: Place) -> Iterator[tuple[Place, dict[str, Any]]]:
        part = self._resolved(part)
        kinds = part.get("type")
        if {"number", "integer"} & set(kinds if isinstance(kinds, list) else [kinds]):
            yield place, part
        for name, inner in part.get("properties", {}).items():
            yield from self._numbers(inner, (*place, name))
        if isinstance(more := part.get("additionalProperties"), dict):
            yield from self._numbers(more, (*place, _name(part)))
        if "items" in part:
            yield from self._numbers(part["items"], (*place, 0))

    def _filled(self, part: dict[str, Any], given: Any) -> Any:  # noqa: ANN401 - JSON
        part = self._resolved(part)
        kinds = part.get("type")
        kinds = kinds if isinstance(kinds, list) else [kinds]
        if "object" in kinds:
            table = given if isinstance(given, dict) else {}
            inner = dict(part.get("properties", {}))
            if isinstance(more := part.get("additionalProperties"), dict):
                inner |= {_name(part): more}
            return table | {name: self._filled(one, table.get(name)) for name, one in inner.items()}
        if "array" in kinds:
            return [self._filled(part["items"], given[0] if given else None)]
        if given is not None:
            return given
        options = [*part.get("enum", ()), part.get("const"), *_TEXTS, 0.5, 1, True]
        return next(one for one in options if one is not None and Draft202012Validator(part).is_valid(one))


def put(record: dict[str, Any], place: Place, value: object) -> dict[str, Any]:
    """Return a record with another value at a place."""
    made = copy.deepcopy(record)
    inner: Any = made
    for step in place[:-1]:
        inner = inner[step]
    inner[place[-1]] = value
    return made


def values(part: dict[str, Any]) -> list[float]:
    """Return numbers at the bounds of a field, beside them and far beyond."""
    least, most = part.get("minimum", 0), part.get("maximum", 1)
    kinds = part["type"]
    if "integer" in kinds:
        return [least, most, least - 1, most + 1, *(int(one) for one in FAR if isinstance(one, int))]
    beside = [math.nextafter(least, -math.inf), math.nextafter(most, math.inf)]
    return [float(least), float(most), *beside, *map(float, FAR)]


def message(channel: Channel, record: dict[str, Any]) -> Outgoing:
    """Return a record as a vehicle would send it, whatever it says."""
    vehicle = record["vehicle"]
    event = {
        "specversion": SPEC_VERSION,
        "id": key_of(record).text if channel is Channel.SHIFT else "x",
        "source": vehicle,
        "type": channel.event_type,
        "time": "2026-01-01T00:00:00.000000Z",
        "datacontenttype": "application/json",
        "dataschema": channel.schema_id,
        "data": record,
    }
    return Outgoing(
        topic=topic_of(vehicle, channel), payload=json.dumps(event).encode(), is_retained=channel.is_retained
    )
