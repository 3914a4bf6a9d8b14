"""Keys of results, and the receipts that a backend gives for them after its commit."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Final
from urllib.parse import quote

from fleet_contract.errors import SchemaError
from fleet_contract.strict_json import JsonObject
from fleet_contract.topics import Channel

MAX_RECEIPTS: Final = 100  # in one message
_MAX_REASON: Final = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultKey:
    """What makes a result that result; the same key again is a repetition."""

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
    texts = [record.get(name) for name in ("vehicle", "stream", "algorithm_version", "calibration_version")]
    seq = record.get("seq")
    vehicle, stream, algorithm, calibration = texts
    if (
        isinstance(vehicle, str)
        and isinstance(stream, str)
        and isinstance(algorithm, str)
        and isinstance(calibration, str)
        and type(seq) is int
    ):
        return ResultKey(
            vehicle=vehicle,
            stream=stream,
            seq=seq,
            algorithm_version=algorithm,
            calibration_version=calibration,
        )
    raise SchemaError("a record without the key of a result")


def ack_records(
    vehicle: str, receipts: Sequence[Receipt], sent_at: str, *, takes_bundles: bool = False
) -> Iterator[JsonObject]:
    """Yield the data of the acknowledgements for results of one vehicle, ``MAX_RECEIPTS`` at a time."""
    more: JsonObject = {"takes_bundles": True} if takes_bundles else {}
    for first in range(0, len(receipts), MAX_RECEIPTS):
        entries = [_entry(receipt) for receipt in receipts[first : first + MAX_RECEIPTS]]
        yield {
            "schema": Channel.ACK.schema_name,
            "vehicle": vehicle,
            "sent_at": sent_at,
            "results": entries,
            **more,
        }


def receipts_of(ack: Mapping[str, object]) -> list[Receipt]:
    """Return the receipts in the data of a checked acknowledgement."""
    vehicle, entries = ack["vehicle"], ack["results"]
    if not isinstance(entries, list):
        raise SchemaError("results must be a list")
    return [_receipt({**entry, "vehicle": vehicle}) for entry in entries]


def takes_bundles(ack: Mapping[str, object]) -> bool:
    """Return whether whoever wrote a checked acknowledgement takes bundles; those before there were any do not say."""
    return ack.get("takes_bundles") is True


def _entry(receipt: Receipt) -> JsonObject:
    key = receipt.key
    return {
        "stream": key.stream,
        "seq": key.seq,
        "algorithm_version": key.algorithm_version,
        "calibration_version": key.calibration_version,
        "outcome": receipt.outcome.value,
        "reason": None if receipt.reason is None else receipt.reason[:_MAX_REASON],
    }


def _receipt(entry: Mapping[str, object]) -> Receipt:
    reason = entry.get("reason")
    return Receipt(
        key=key_of(entry),
        outcome=Outcome(str(entry["outcome"])),
        reason=None if reason is None else str(reason),
    )
