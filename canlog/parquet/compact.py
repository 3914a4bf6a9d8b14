"""Records in Thrift's compact protocol, which the headers and the footer of a Parquet file are written in."""

from collections.abc import Sequence
from typing import Final

TRUE, FALSE, I32, I64, BINARY, LIST, STRUCT = 1, 2, 5, 6, 8, 9, 12
STOP: Final = b"\0"
_SHORT_LIST: Final = 15
Field = tuple[int, int, bytes]  # number, type, what is written


_SMALL: Final = [bytes([low]) if not high else bytes([low | 0x80, high]) for high in range(128) for low in range(128)]


def varint(number: int) -> bytes:
    """Return a number that is not negative, in groups of seven bits."""
    if number < len(_SMALL):
        return _SMALL[number]
    low, rest = number & 0x7F | 0x80, number >> 7
    if rest < len(_SMALL):
        return bytes([low]) + _SMALL[rest]
    return bytes([low, rest & 0x7F | 0x80]) + varint(rest >> 7)


def integer(number: int) -> bytes:
    """Return a whole number of up to 64 bits."""
    return varint(number << 1 if number >= 0 else (-number << 1) - 1)


def binary(content: bytes) -> bytes:
    """Return bytes."""
    return varint(len(content)) + content


def text(content: str) -> bytes:
    """Return a text; half of a surrogate pair, which no text may have, becomes a question mark."""
    return binary(content.encode(errors="replace"))


def listed(kind: int, items: Sequence[bytes]) -> bytes:
    """Return a list of items of one type."""
    count = len(items)
    head = bytes([count << 4 | kind]) if count < _SHORT_LIST else bytes([0xF0 | kind]) + varint(count)
    return head + b"".join(items)


def struct(*fields: Field) -> bytes:
    """Return a record of fields with rising numbers, less than sixteen apart; a truth value is written as its type."""
    parts, last = [], 0
    for number, kind, content in fields:
        parts += [bytes([number - last << 4 | kind]), content]
        last = number
    return b"".join((*parts, STOP))
