"""Builders of fleet messages and rows: what vehicles send, what the backend stores."""

from dataclasses import replace
from datetime import UTC, datetime

from clutch_results.records import Condition, ShiftResult, shift_record
from fleet_backend.rows import Row, shift_row
from fleet_contract import Outgoing, shift_message
from fleet_link import Message
from tests.support.builders import shift_result

NOW = datetime(2026, 3, 1, 12, tzinfo=UTC)
START = datetime(2026, 1, 1, tzinfo=UTC)


def fleet_result(
    seq: int = 1,
    *,
    vehicle: str = "car1",
    stream: str = "stream-1",
    clutch: int = 2,
    condition: Condition = Condition.GOOD,
    algorithm: str = "algorithm-1",
    produced_at: str | None = None,
) -> ShiftResult:
    """Return a result whose times grow with ``seq``, four seconds apart."""
    result = shift_result(seq, vehicle=vehicle, stream=stream, to_gear=2 if clutch == 2 else 3)
    verdict = replace(result.verdict, condition=condition)
    moment = datetime.fromtimestamp(START.timestamp() + 4.0 * seq, UTC)
    return replace(
        result,
        verdict=verdict,
        algorithm_version=algorithm,
        produced_at=produced_at or moment.strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
    )


def row_of(result: ShiftResult) -> Row:
    """Return the row that a result becomes."""
    return shift_row(shift_record(result))


def message_of(result: ShiftResult, packet_id: int = 1) -> Message:
    """Return a result as a broker delivers it."""
    return delivered(shift_message(shift_record(result)), packet_id)


def delivered(message: Outgoing, packet_id: int = 1) -> Message:
    """Return a message as a broker delivers it."""
    return Message(topic=message.topic, payload=message.payload, packet_id=packet_id)
