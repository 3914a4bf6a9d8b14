"""What becomes of messages: rows, receipts, poison."""

import json
import zlib
from dataclasses import replace

import pytest

from fleet_backend.intake import MessageKind, Taken, take, take_all
from fleet_backend.rows import moment
from fleet_link import Message
from tests.golden import messages_v1
from tests.support.fleet import NOW, delivered, fleet_result, message_of

GOOD = message_of(fleet_result(7))


def changed(message: Message, **data: object) -> Message:
    """Return a message whose data say something else."""
    event = json.loads(message.payload)
    event["data"] |= data
    return replace(message, payload=json.dumps(event).encode())


def poison(message: Message, reason: str) -> Taken:
    taken = take(message, NOW)
    assert (taken.kind, taken.row["reason"]) == (MessageKind.POISON, reason), taken.row["detail"]
    return taken


def bundle(*payloads: bytes) -> Message:
    return Message(
        topic="clutchdiag/v1/car1/bundle", payload=zlib.compress(b"[" + b",".join(payloads) + b"]"), packet_id=1
    )


def test_each_result_of_a_bundle_is_judged_as_if_it_had_come_alone() -> None:
    stranger = changed(GOOD, vehicle="car2")
    alone = [GOOD, changed(GOOD, quality=2.0), stranger, replace(GOOD, payload=b"7"), message_of(fleet_result(8))]
    taken = take_all(bundle(*(message.payload for message in alone)), NOW)
    assert taken == [take(replace(message, packet_id=1), NOW) for message in alone]
    reasons = [item.row["reason"] if item.kind is MessageKind.POISON else None for item in taken]
    assert reasons == [None, "schema", "identity", "malformed", None]
    assert take_all(GOOD, NOW) == [take(GOOD, NOW)]


def test_what_cannot_be_unpacked_is_one_message_kept_aside() -> None:
    for message in (replace(bundle(), payload=b"x"), bundle(), bundle(*[b"1"] * 51)):
        (taken,) = take_all(message, NOW)
        assert (taken.kind, taken.row["reason"], taken.receipt) == (MessageKind.POISON, "malformed", None)
        assert (taken.row["vehicle"], taken.message) == ("car1", message)
    (taken,) = take_all(replace(bundle(GOOD.payload), topic="clutchdiag/v1/car 1/bundle"), NOW)
    assert taken.row["reason"] == "topic"


@pytest.mark.parametrize(
    ("name", "said", "kept"),
    [
        ("status-online", "connected_at", "connected_at"),
        ("metrics", "produced_at", "metrics_at"),
        ("controller", "produced_at", "controller_at"),
    ],
)
def test_a_state_of_a_clock_that_is_far_ahead_is_of_when_it_came(name: str, said: str, kept: str) -> None:
    message, near = delivered(messages_v1()[name]), "2026-03-02T11:00:00.000000Z"
    found = [take(changed(message, **{said: at}), NOW).row[kept] for at in (near, near.replace("2026", "2038"))]
    assert found == [moment(near), NOW]
