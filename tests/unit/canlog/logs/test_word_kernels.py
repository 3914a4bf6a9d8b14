"""Eight characters read at once say what they say one after the other."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.logs.text_kernels import (
    NO_DIGITS,
    WORD_BYTES,
    decimal_digits,
    half,
    hex_digits,
    lower,
    reversed_bytes,
    word,
)

EIGHT = st.binary(min_size=WORD_BYTES, max_size=WORD_BYTES)
HEXADECIMAL, DECIMAL = frozenset(b"0123456789abcdefABCDEF"), frozenset(b"0123456789")


def as_word(text: bytes) -> np.uint64:
    """Return eight characters as the compiled readers load them."""
    return np.uint64(word(np.frombuffer(text, np.uint8), 0))


def wanted_hex(text: bytes) -> int:
    """Return what eight characters say as hexadecimal."""
    return int.from_bytes(bytes.fromhex(text.decode()), "little") if HEXADECIMAL.issuperset(text) else NO_DIGITS


def wanted_decimal(text: bytes) -> int:
    """Return what eight characters say as a number."""
    return int(text) if DECIMAL.issuperset(text) else NO_DIGITS


@pytest.mark.parametrize("place", range(WORD_BYTES))
def test_every_character_in_every_place(place: int) -> None:
    for character in range(256):
        text = bytearray(b"19087254")
        text[place] = character
        assert hex_digits(as_word(bytes(text))) == wanted_hex(bytes(text))
        assert decimal_digits(as_word(bytes(text))) == wanted_decimal(bytes(text))


@settings(deadline=None)  # the first call compiles
@given(EIGHT | st.text("0123456789abcdefABCDEF", min_size=8, max_size=8).map(str.encode))
def test_any_eight_characters(text: bytes) -> None:
    assert hex_digits(as_word(text)) == wanted_hex(text)
    assert decimal_digits(as_word(text)) == wanted_decimal(text)


@settings(deadline=None)  # the first call compiles
@given(EIGHT)
def test_numbers_are_little_endian(raw: bytes) -> None:
    column = np.frombuffer(b"x" + raw, np.uint8)
    assert half(column, 1) == int.from_bytes(raw[:2], "little")
    assert lower(column, 1) == int.from_bytes(raw[:4], "little")
    assert word(column, 1) == int.from_bytes(raw, "little")
    assert reversed_bytes(lower(column, 1)) == int.from_bytes(raw[:4], "big")
