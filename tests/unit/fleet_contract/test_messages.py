"""Messages and topics: written, read back, and refused."""

import json
import random
import tracemalloc
import zlib
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clutch_results.records import clutch_record, shift_record
from fleet_contract import (
    MAX_BUNDLED,
    Address,
    Channel,
    ContractError,
    IdentityError,
    MalformedError,
    Outgoing,
    Receipt,
    SchemaError,
    TopicError,
    ack_messages,
    bundle_messages,
    bundled_events,
    clutch_message,
    key_of,
    parse_object,
    parse_topic,
    read_message,
    receipts_of,
    shift_message,
    topic_of,
)
from fleet_contract.messages import MAX_BUNDLE_BYTES, MAX_RECEIPTS
from fleet_contract.strict_json import MAX_DEPTH
from tests.support.builders import shift_result

SHIFT = shift_message(shift_record(shift_result()))
CLUTCH = clutch_message(clutch_record(shift_record(shift_result())))


def changed(payload: bytes, *path: str, value: object) -> bytes:
    """Return a payload with one value replaced."""
    event: dict[str, Any] = json.loads(payload)
    target = event
    for name in path[:-1]:
        target = target[name]
    target[path[-1]] = value
    return json.dumps(event).encode()


def test_unknown_keys_are_ignored() -> None:
    payload = changed(changed(SHIFT.payload, "traceparent", value="00-1"), "data", "colour", value="amber")
    assert read_message(SHIFT.topic, payload).data["colour"] == "amber"


@pytest.mark.parametrize(
    ("path", "value", "kind"),
    [
        (("data", "vehicle"), "car2", IdentityError),
        (("id",), "car1/another/1/a/b", IdentityError),
        (("data", "seq"), 2, IdentityError),
        (("type",), "clutchdiag.clutch.v1", IdentityError),
        (("specversion",), "0.3", SchemaError),
        (("time",), "2026-13-01T00:00:00.000000Z", SchemaError),
        (("data",), [], SchemaError),
        (("data", "seq"), 0, SchemaError),
        (("data", "seq"), 1.0, SchemaError),
        (("data", "quality"), 1.5, SchemaError),
        (("data", "friction", "mu_c"), "0.1", SchemaError),
        (("data", "verdict", "condition"), "splendid", SchemaError),
        (("data", "reasons"), ["misfit", "misfit"], SchemaError),
        (("data", "stream"), "s" * 129, SchemaError),
        (("data", "verdict", "reason"), "x" * 17_000, MalformedError),
    ],
)
def test_a_message_that_lies_or_errs_is_refused(path: tuple[str, ...], value: object, kind: type) -> None:
    with pytest.raises(ContractError) as caught:
        read_message(SHIFT.topic, changed(SHIFT.payload, *path, value=value))
    assert type(caught.value) is kind
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("topic", "kind"),
    [
        ("clutchdiag/v1/car2/shift", IdentityError),
        ("clutchdiag/v1/car1/clutch/2", SchemaError),
        ("clutchdiag/v1/car1/nothing", TopicError),
    ],
)
def test_a_message_on_another_topic_is_refused(topic: str, kind: type) -> None:
    with pytest.raises(kind):
        read_message(topic, SHIFT.payload)


def test_a_clutch_state_belongs_to_its_clutch() -> None:
    with pytest.raises(IdentityError, match="clutch is 2 where 1 belongs"):
        read_message("clutchdiag/v1/car1/clutch/1", CLUTCH.payload)


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


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "cut short"),
        (zlib.compress(TEXT)[:-1], "cut short"),
        (zlib.compress(TEXT)[:-1] + b"x", "zlib did not pack"),  # the sum at its end
        (zlib.compress(TEXT) + b"x", "behind its end"),
        (b"\x00" * (Channel.BUNDLE.max_bytes + 1), "65537 bytes, more than 65536"),
        (zlib.compress(b"[]"), "0 results"),
        (zlib.compress(b"[" + b"1," * MAX_BUNDLED + b"1]"), "51 results"),
        (zlib.compress(ALONE.payload), "without a JSON array"),
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


NOW = "2026-01-01T00:00:00.000000Z"
KEY = key_of(shift_record(shift_result()))


def test_receipts_are_read_back_in_as_many_messages_as_they_need() -> None:
    receipts = [Receipt(key=replace(KEY, seq=seq)) for seq in range(1, 2 * MAX_RECEIPTS + 2)]
    messages = list(ack_messages("car1", receipts, sent_at=NOW, worker="w"))
    assert len(messages) == 3
    incoming = [read_message(message.topic, message.payload) for message in messages]
    assert [receipt for one in incoming for receipt in receipts_of(one.data)] == receipts
    assert len({one.event_id for one in incoming}) == len(messages)


@pytest.mark.parametrize("change", [{"seq": "1"}, {"seq": True}, {"stream": None}, {"vehicle": 7}])
def test_no_key_without_all_its_parts(change: dict[str, object]) -> None:
    with pytest.raises(SchemaError):
        key_of(shift_record(shift_result()) | change)


ADDRESSES = [
    Address(vehicle="car-1", channel=channel, clutch=2 if channel is Channel.CLUTCH else None) for channel in Channel
]


@pytest.mark.parametrize("address", ADDRESSES, ids=lambda address: address.channel.label)
def test_a_topic_is_read_back(address: Address) -> None:
    assert parse_topic(address.topic) == address
    assert topic_of(address.vehicle, address.channel, address.clutch) == address.topic


@pytest.mark.parametrize(
    "topic",
    [
        "",
        "clutchdiag/v1/car1",
        "clutchdiag/v1/car1/shift/1",
        "clutchdiag/v1/car1/clutch",
        "clutchdiag/v1/car1/clutch/3",
        "clutchdiag/v1/car1/horn",
        "clutchdiag/v1/../shift",
        "clutchdiag/v1/car1\n/shift",
        "clutchdiag/v1/+/shift",
        "clutchdiag/v2/car1/shift",
        "x/clutchdiag/v1/car1/shift",
        f"clutchdiag/v1/{'a' * 65}/shift",
    ],
)
def test_no_other_topic_is_ours(topic: str) -> None:
    with pytest.raises(TopicError):
        parse_topic(topic)


LIMIT = 1_000_000


def nested(depth: int, opening: str = '{"a":', middle: str = "1", closing: str = "}") -> bytes:
    return (opening * depth + middle + closing * depth).encode()


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"{",
        b"[]",
        b'{"a":1}{"a":2}',
        b'{"a":NaN}',
        b'{"a":1e999}',
        b'{"a":9223372036854775808}',
        b'{"a":' + b"9" * 100_000 + b"}",
        b'{"a":1,"a":2}',
        b'{"a":{"b":1,"b":1}}',
        b'{"a" :1,"a":2}',
        b'{"a":0.12345678901234567890123,"b":18446744073709551615}',
        b'{"a":"\xff"}',
        rb'{"a":"\ud800"}',
        rb'{"a":"\u0000"}',
        b'{"a":"\x00"}',
        b"\xef\xbb\xbf{}",
        nested(MAX_DEPTH + 1),
        nested(100_000),
        b'{"a":' + nested(50_000, "[", "", "]") + b"}",
    ],
    ids=lambda payload: repr(payload[:24]),
)
def test_what_is_no_sound_object_is_refused(payload: bytes) -> None:
    with pytest.raises(MalformedError) as caught:
        parse_object(payload, LIMIT)
    assert len(str(caught.value)) < 200
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("payload", "value"),
    [
        (b"{}", {}),
        (b'{"a":[1,2.5,true,null,"x"]}', {"a": [1, 2.5, True, None, "x"]}),
        (b'{"a":-9223372036854775808}', {"a": -(2**63)}),
        (b'{"a":0.0001234567890123456789,"b":9223372036854775807}', {"a": 0.0001234567890123456789, "b": 2**63 - 1}),
        (rb'{"a":"\\u0000"}', {"a": "\\u0000"}),
        (rb'{"a":"\u00e9\ud83d\ude97"}', {"a": "é\U0001f697"}),
        (b'{"a":"' + b"{[" * 40 + b'"}', {"a": "{[" * 40}),
        (rb'{"a":"\"{{{{{{{{{{{{{{{{{{{{"}', {"a": '"' + "{" * 20}),
    ],
    ids=lambda value: repr(value)[:24],
)
def test_what_is_sound_is_read(payload: bytes, value: object) -> None:
    assert parse_object(payload, LIMIT) == value
