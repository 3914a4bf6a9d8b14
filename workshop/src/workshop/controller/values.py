"""Values of the controller as bytes on the wire: units, scaling, and the codes for what is not known."""

import math
import re
import struct
from collections.abc import Iterator, Mapping
from typing import Final

from workshop.controller.descriptions import Coding, Condition, Field

Value = float | str | bytes
Values = Mapping[str, Value]  # of the controller, by source; numbers in SI

_FORMATS: Final = {4: ">f", 8: ">d"}  # of IEEE 754, by bytes


def encode(fields: tuple[Field, ...], values: Values, *, keeps_code: bool = True) -> bytes:
    """Return the bytes of fields; a value that is missing or not a number becomes the code for not available.

    Unless ``keeps_code``, that code also stands for the highest value, as OBD has it.
    """
    return b"".join(_encoded(entry, values.get(entry.source), keeps_code=keeps_code) for entry in fields)


def not_available(entry: Field) -> int:
    """Return the number that says that a value is not known: all bits set, the most negative one if signed.

    A float has no such number: it is not a number then.
    """
    bits = 8 * entry.size_bytes
    return -(1 << (bits - 1)) if entry.kind is Coding.SIGNED else (1 << bits) - 1


def _encoded(entry: Field, value: Value | None, *, keeps_code: bool) -> bytes:
    if entry.kind is Coding.TEXT:
        return (
            str("" if value is None else value).encode("ascii", "replace")[: entry.size_bytes].ljust(entry.size_bytes)
        )
    if entry.kind is Coding.BYTES:
        raw = value if isinstance(value, bytes) else b""
        return raw[: entry.size_bytes].ljust(entry.size_bytes, b"\0")
    if entry.kind is Coding.FLOAT:
        return _float_bytes(entry, float(value) if isinstance(value, int | float) else math.nan)
    number = (
        _number(entry, float(value), keeps_code=keeps_code) if isinstance(value, int | float) else not_available(entry)
    )
    return number.to_bytes(entry.size_bytes, "big", signed=entry.kind is Coding.SIGNED)


def _float_bytes(entry: Field, value: float) -> bytes:
    """Return a number as IEEE 754 has it; one that is too large for four bytes is infinite."""
    number = entry.conversion[0](value)
    try:
        return struct.pack(_FORMATS[entry.size_bytes], number)
    except OverflowError:
        return struct.pack(_FORMATS[entry.size_bytes], math.copysign(math.inf, number))


def _number(entry: Field, value: float, *, keeps_code: bool) -> int:
    """Return what stands for a value: the nearest step, or the last one before the code for not available."""
    if math.isnan(value):
        return not_available(entry)
    bits = 8 * entry.size_bytes
    low, high = (
        (1 - (1 << (bits - 1)), (1 << (bits - 1)) - 1)
        if entry.kind is Coding.SIGNED
        else (0, (1 << bits) - 1 - keeps_code)
    )
    steps = (entry.conversion[0](value) - entry.offset) / entry.resolution
    return high if steps >= high else low if steps <= low else round(steps)


def _pieces(fields: tuple[Field, ...], raw: bytes) -> Iterator[tuple[Field, bytes]]:
    """Yield each field and its bytes."""
    place = 0
    for entry in fields:
        yield entry, raw[place : place + entry.size_bytes]
        place += entry.size_bytes


def decoded(fields: tuple[Field, ...], raw: bytes) -> dict[str, float]:
    """Return the numbers in bytes by source, in SI; those that are not available are missing."""
    available = ((entry, piece) for entry, piece in _pieces(fields, raw) if _is_available(entry, piece))
    return {entry.source: entry.conversion[1](decode_number(entry, piece)) for entry, piece in available}


def _is_available(entry: Field, raw: bytes) -> bool:
    if entry.kind is Coding.FLOAT:
        return not math.isnan(decode_number(entry, raw))
    return int.from_bytes(raw, "big", signed=entry.kind is Coding.SIGNED) != not_available(entry)


def decode_number(entry: Field, raw: bytes) -> float:
    if entry.kind is Coding.FLOAT:
        return float(struct.unpack(_FORMATS[entry.size_bytes], raw)[0])
    steps = int.from_bytes(raw, "big", signed=entry.kind is Coding.SIGNED)
    return steps * entry.resolution + entry.offset


def are_valid(fields: tuple[Field, ...], raw: bytes) -> bool:
    """Return whether bytes, which are as long as the fields, are within what the fields allow."""
    return all(_is_valid(entry, piece) for entry, piece in _pieces(fields, raw))


def _is_valid(entry: Field, raw: bytes) -> bool:
    if entry.kind is Coding.BYTES:
        return not entry.pattern or re.fullmatch(entry.pattern, raw.hex()) is not None
    if entry.kind is Coding.TEXT:
        is_printable = all(0x20 <= byte < 0x7F for byte in raw)
        return is_printable and (not entry.pattern or re.fullmatch(entry.pattern, raw.decode("ascii")) is not None)
    return _is_within(entry, decode_number(entry, raw))


def holds(condition: Condition, values: Values) -> bool:
    """Return whether a condition holds; it does not if its value is not known."""
    value = values.get(condition.source)
    if not isinstance(value, int | float) or math.isnan(value):
        return False
    return _is_within(condition, value)


def _is_within(limits: Field | Condition, value: float) -> bool:
    is_above = limits.minimum is None or value >= limits.minimum
    return is_above and (limits.maximum is None or value <= limits.maximum)
