"""Bundles: packed and unpacked without loss, within their bounds, and nothing else taken for one."""

import json
import random
import tracemalloc
import zlib
from contextlib import suppress
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diag_service.diagnosis.records import shift_record
from fleet_contract import (
    MAX_BUNDLE_BYTES,
    MAX_BUNDLED,
    Channel,
    ContractError,
    MalformedError,
    Outgoing,
    Receipt,
    ack_messages,
    bundle_messages,
    bundled_events,
    key_of,
    read_message,
    shift_message,
    takes_bundles,
)
from tests.support.builders import shift_result

ALONE = shift_message(shift_record(shift_result()))
TEXT = b"[" + b",".join([ALONE.payload] * 2) + b"]"


def results(count: int, size_bytes: int = 0) -> list[Outgoing]:
    """Return messages of so many results, each made as long as is asked with what zlib cannot pack."""
    rng = random.Random(count)  # noqa: S311 - no secret
    made = []
    for number in range(count):
        text = shift_message(shift_record(shift_result(number + 1))).payload
        noise = rng.randbytes(max(0, size_bytes - len(text)) // 2 + 1).hex().encode()
        made.append(replace(ALONE, payload=text[:-1] + b',"noise":"' + noise + b'"}' if size_bytes else text))
    return made


@pytest.mark.parametrize("count", [0, 1, 2, MAX_BUNDLED, MAX_BUNDLED + 1, 3 * MAX_BUNDLED + 2])
def test_results_are_bundled_in_order_and_come_out_as_they_went_in(count: int) -> None:
    messages = results(count)
    bundles = list(bundle_messages(messages))
    assert len(bundles) == -(-count // MAX_BUNDLED)
    events = []
    for bundle in bundles:
        is_alone = bundle in messages
        assert is_alone or bundle.topic == "clutchdiag/v1/car1/bundle"
        events += [bundle.payload] if is_alone else bundled_events(bundle.payload)
    assert events == [message.payload for message in messages]
    assert (count % MAX_BUNDLED == 1) == any(bundle in messages for bundle in bundles)


@pytest.mark.parametrize("size_bytes", [5_000, 16_000])
def test_long_results_make_smaller_bundles(size_bytes: int) -> None:
    messages = results(MAX_BUNDLED, size_bytes)
    bundles = list(bundle_messages(messages))
    assert all(len(bundle.payload) <= Channel.BUNDLE.max_bytes for bundle in bundles)
    assert [event for bundle in bundles for event in bundled_events(bundle.payload)] == [
        message.payload for message in messages
    ]


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "cut short"),
        (b"nothing packed", "zlib did not pack"),
        (zlib.compress(TEXT)[:-1], "cut short"),
        (zlib.compress(TEXT)[:-1] + b"x", "zlib did not pack"),  # the sum at its end
        (zlib.compress(TEXT) + b"x", "behind its end"),
        (b"\x00" * (Channel.BUNDLE.max_bytes + 1), "65537 bytes, more than 65536"),
        (zlib.compress(b"[]"), "0 results"),
        (zlib.compress(b"[" + b"1," * MAX_BUNDLED + b"1]"), "51 results"),
        (zlib.compress(ALONE.payload), "without a JSON array"),
        (zlib.compress(b'[{"a":1}'), "without a JSON array"),
        (zlib.compress(b"[" * (MAX_BUNDLE_BYTES // 2)), "without a JSON array"),
        (zlib.compress(b" " * (MAX_BUNDLE_BYTES + 1)), "more than 262144 bytes when it is unpacked"),
    ],
)
def test_what_is_no_bundle_is_malformed(payload: bytes, words: str) -> None:
    with pytest.raises(MalformedError, match=words):
        bundled_events(payload)


def test_a_bomb_takes_no_more_memory_than_the_longest_bundle() -> None:
    bomb = zlib.compress(b"\x00" * 10_000_000, 9)
    assert len(bomb) < Channel.BUNDLE.max_bytes
    tracemalloc.start()
    try:
        with pytest.raises(MalformedError):
            bundled_events(bomb)
        _, most_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most_bytes < 4 * MAX_BUNDLE_BYTES


@settings(max_examples=50)
@given(st.binary(max_size=200) | st.binary(max_size=400).map(zlib.compress) | st.text().map(json.dumps))
def test_whatever_comes_is_events_or_an_error_of_the_contract(payload: bytes | str) -> None:
    data = zlib.compress(b"[" + payload.encode() + b"]") if isinstance(payload, str) else payload
    events: list[bytes] = []
    with suppress(ContractError):
        events = bundled_events(data)
    assert len(events) <= MAX_BUNDLED
    assert not isinstance(payload, str) or [json.loads(event) for event in events] == [json.loads(payload)]


def test_a_bundle_is_no_message() -> None:
    with pytest.raises(MalformedError, match="a bundle"):
        read_message("clutchdiag/v1/car1/bundle", zlib.compress(TEXT))


@pytest.mark.parametrize("is_so", [False, True])
def test_an_acknowledgement_says_whether_bundles_are_taken(*, is_so: bool) -> None:
    receipts = [Receipt(key=key_of(shift_record(shift_result())))]
    now = "2026-01-01T00:00:00.000000Z"
    (ack,) = ack_messages("car1", receipts, sent_at=now, worker="w", takes_bundles=is_so)
    assert takes_bundles(read_message(ack.topic, ack.payload).data) is is_so
    (older,) = ack_messages("car1", receipts, sent_at=now, worker="w")
    assert b"takes_bundles" not in older.payload
