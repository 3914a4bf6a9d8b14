"""JSON as strangers may send it: bounded before it is parsed, and nothing in it that a database cannot keep."""

import json
import math
import re
from collections.abc import Mapping
from typing import Final, NoReturn

from fleet_contract.errors import MalformedError

JsonObject = dict[str, object]

MAX_DEPTH: Final = 16
_INT64: Final = range(-(2**63), 2**63)
_LONGEST_INT64: Final = len(str(-(2**63)))
_STRING_OR_BRACKET: Final = re.compile(rb'"(?:[^"\\]|\\.)*+"|[\[\]{}]', re.DOTALL)
_SHOWN_LENGTH: Final = 60


def dump(record: Mapping[str, object]) -> str:
    """Return a record as one line of JSON; floats keep every bit.

    Raises
    ------
    MalformedError
        If a number is NaN or infinite, which JSON cannot carry.
    """
    try:
        return _STRICT.encode(record)
    except ValueError as exc:
        raise MalformedError(f"a number is not finite: {shown(str(record))}") from exc


def parse_object(payload: bytes, max_bytes: int) -> JsonObject:
    """Return the JSON object in a payload.

    Raises
    ------
    MalformedError
        If it is longer than ``max_bytes``, deeper than ``MAX_DEPTH``, not UTF-8, not an object, names a key twice or
        holds NaN, Infinity, a number outside 64 bits, NUL or half a surrogate pair.
    """
    if len(payload) > max_bytes:
        raise MalformedError(f"{len(payload)} bytes, more than {max_bytes}")
    if payload.count(b"{") + payload.count(b"[") > MAX_DEPTH:  # more could be deeper: look closely
        _check_depth(payload)
    try:
        value = _DECODER.decode(payload.decode())
        if b"\\" in payload and b"\\u" in payload:  # a single byte is found ten times as fast
            _check_characters(value)
    except (ValueError, RecursionError) as exc:
        raise MalformedError(f"no JSON: {shown(str(exc))}") from exc
    if not isinstance(value, dict):
        raise MalformedError(f"no JSON object: {shown(str(value))}")
    return value


def shown(text: str) -> str:
    """Return the start of a text in one printable line."""
    line = text if len(text) <= _SHOWN_LENGTH else f"{text[:_SHOWN_LENGTH]}..."
    return line if line.isprintable() else repr(line)


def _check_depth(payload: bytes) -> None:
    depth = 0
    for token in _STRING_OR_BRACKET.finditer(payload):
        start = payload[token.start()]
        if start in b"{[":
            depth += 1
            if depth > MAX_DEPTH:
                raise MalformedError(f"nested deeper than {MAX_DEPTH}")
        elif start in b"]}":
            depth -= 1


def _check_characters(value: object) -> None:
    """Raise ValueError for half a surrogate pair, which UTF-8 cannot encode, or NUL, which PostgreSQL cannot store."""
    text = json.dumps(value, ensure_ascii=False)
    text.encode()  # raises UnicodeEncodeError, a ValueError
    if re.search(r"(?<!\\)(?:\\\\)*\\u0000", text):
        raise ValueError("a text holds NUL")


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{shown(text)} is too large")
    return number


def _int64(text: str) -> int:
    if len(text) > _LONGEST_INT64 or (number := int(text)) not in _INT64:
        raise ValueError(f"{shown(text)} does not fit into 64 bits")
    return number


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number of JSON")


def _unique(pairs: list[tuple[str, object]]) -> JsonObject:
    table = dict(pairs)
    if len(table) != len(pairs):
        raise ValueError("a name occurs twice")
    return table


_STRICT: Final = json.JSONEncoder(allow_nan=False, separators=(",", ":"))
_DECODER: Final = json.JSONDecoder(
    parse_float=_finite, parse_int=_int64, parse_constant=_refuse, object_pairs_hook=_unique
)
