"""Receipts: every key of a commit, in messages of bounded length, read back as they were given."""

from dataclasses import replace

import pytest

from diag_service.diagnosis.records import shift_record
from fleet_contract import (
    MAX_RECEIPTS,
    Channel,
    Outcome,
    Receipt,
    ResultKey,
    SchemaError,
    ack_messages,
    key_of,
    read_message,
    receipts_of,
)
from tests.support.builders import shift_result

NOW = "2026-01-01T00:00:00.000000Z"
KEY = key_of(shift_record(shift_result()))


def test_receipts_are_read_back_in_as_many_messages_as_they_need() -> None:
    receipts = [Receipt(key=replace(KEY, seq=seq)) for seq in range(1, 2 * MAX_RECEIPTS + 2)]
    messages = list(ack_messages("car1", receipts, sent_at=NOW, worker="w"))
    assert len(messages) == 3
    incoming = [read_message(message.topic, message.payload) for message in messages]
    assert [receipt for one in incoming for receipt in receipts_of(one.data)] == receipts
    assert len({one.event_id for one in incoming}) == len(messages)


def test_the_longest_acknowledgement_is_within_the_limit() -> None:
    longest = ResultKey(
        vehicle="v" * 64, stream='"' * 128, seq=2**63 - 1, algorithm_version='"' * 128, calibration_version='"' * 128
    )
    receipts = [Receipt(key=longest, outcome=Outcome.QUARANTINED, reason="\U0001f697" * 999)] * MAX_RECEIPTS
    (message,) = ack_messages("v" * 64, receipts, sent_at=NOW, worker="w")
    assert len(message.payload) > Channel.ACK.max_bytes // 2
    first, *_ = receipts_of(read_message(message.topic, message.payload).data)
    assert first == replace(receipts[0], reason="\U0001f697" * 100)


def test_nothing_to_say_is_no_message() -> None:
    assert list(ack_messages("car1", [], sent_at=NOW, worker="w")) == []


def test_a_key_is_one_word_whatever_is_in_it() -> None:
    odd = replace(KEY, stream="a/b c", calibration_version="1+0/x")
    assert odd.text == "car1/a%2Fb%20c/1/algorithm-1/1+0%2Fx"


@pytest.mark.parametrize("change", [{"seq": "1"}, {"seq": True}, {"stream": None}, {"vehicle": 7}])
def test_no_key_without_all_its_parts(change: dict[str, object]) -> None:
    with pytest.raises(SchemaError):
        key_of(shift_record(shift_result()) | change)
