"""Results of a fleet as they go on air: each a message of its own, or those that wait together in bundles.

Their numbers differ from each other and have all their digits, as those of drives have; else a bundle would be packed
ten times smaller than any real one.
"""

import random
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime

from studies.fleet_load import Wire, wire
from diag_service.diagnosis.records import shift_record
from fleet_contract import MAX_BUNDLED, Outgoing, bundle_messages, shift_message
from tests.support.fleet import fleet_result

_SPREAD = 1e-3  # of numbers, towards zero: what the schemas bound stays within


def varied(value: object, rng: random.Random) -> object:
    """Return a record whose numbers with fractions are others."""
    if isinstance(value, dict):
        return {key: varied(one, rng) for key, one in value.items()}
    return value * (1.0 - _SPREAD * rng.random()) if isinstance(value, float) else value


def outgoing(vehicle: str, seq: int, moment: str, rng: random.Random, stream: str = "live") -> Outgoing:
    """Return the message of a result."""
    result = replace(fleet_result(seq, vehicle=vehicle, clutch=1 + seq % 2), stream=stream, produced_at=moment)
    record = varied(shift_record(result), rng)
    if not isinstance(record, dict):
        raise TypeError("no record")
    return shift_message(record)


def alone(vehicle_count: int, first: int, count: int) -> list[Wire]:
    """Return results of all vehicles in turn, made now, from a position of their streams on."""
    rng, moment = random.Random(first), _now()  # noqa: S311 - no secret
    keys = [(f"h{1 + number % vehicle_count}", first + number // vehicle_count) for number in range(count)]
    return [_wire(outgoing(vehicle, seq, moment, rng), [(vehicle, seq)]) for vehicle, seq in keys]


def bundled(vehicle_count: int, first: int, count: int) -> list[Wire]:
    """Return the same as vehicles send what waited, by the function that their outbox has for it: bundles in turn."""
    rng, moment, each = random.Random(first), _now(), count // vehicle_count  # noqa: S311
    return list(_bundles(vehicle_count, first, each, moment, rng))


def _bundles(vehicle_count: int, first: int, each: int, moment: str, rng: random.Random) -> Iterator[Wire]:
    for start in range(first, first + each, MAX_BUNDLED):
        seqs = range(start, min(start + MAX_BUNDLED, first + each))
        for number in range(1, vehicle_count + 1):
            vehicle = f"h{number}"
            for bundle in bundle_messages([outgoing(vehicle, seq, moment, rng) for seq in seqs]):
                yield _wire(bundle, [(vehicle, seq) for seq in seqs])


def _wire(message: Outgoing, keys: list[tuple[str, int]]) -> Wire:
    return wire(message.topic, message.payload, keys)


def _now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
