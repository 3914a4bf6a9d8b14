"""Bytes from strangers: bounded, finite, unambiguous, or refused with one short line."""

import pytest

from fleet_contract import MalformedError, parse_object
from fleet_contract.strict_json import MAX_DEPTH

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
