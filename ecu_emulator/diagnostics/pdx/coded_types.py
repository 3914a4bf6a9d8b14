"""How values are coded on the wire, and what they mean: DIAG-CODED-TYPE, COMPU-METHOD and what may be in between."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final
from xml.etree.ElementTree import Element

from ecu_emulator.diagnostics.descriptions import Field, Kind
from ecu_emulator.diagnostics.pdx.elements import listed, node
from ecu_emulator.diagnostics.values import not_available

LONGEST_NUMBER_BYTES: Final = 4  # ODX has no longer whole numbers
UNDEFINED: Final = "undefined"  # the meaning of a number that has none


@dataclass(frozen=True, slots=True, kw_only=True)
class Coding:
    """All of a DATA-OBJECT-PROP but its name."""

    method: Element
    coded_type: Element
    physical_type: Element
    constraint: Element | None = None  # of what is on the wire
    unit: str = ""
    physical_constraint: Element | None = None


def standard_type(data_type: str, bits: int, encoding: str = "") -> Element:
    """Return the type of a value of fixed length."""
    attributes = {"BASE-TYPE-ENCODING": encoding} if encoding else {}
    return node(
        "DIAG-CODED-TYPE",
        {"BASE-DATA-TYPE": data_type, **attributes, "xsi:type": "STANDARD-LENGTH-TYPE"},
        node("BIT-LENGTH", str(bits)),
    )


def unsigned(size_bytes: int, *, is_hexadecimal: bool = False) -> Coding:
    """Return the coding of a plain number."""
    radix = {"DISPLAY-RADIX": "HEX"} if is_hexadecimal else {}
    return Coding(
        method=_identical(),
        coded_type=standard_type("A_UINT32", 8 * size_bytes),
        physical_type=node("PHYSICAL-TYPE", {"BASE-DATA-TYPE": "A_UINT32", **radix}),
    )


def scaled(size_bytes: int, resolution: float, unit: str) -> Coding:
    """Return the coding of a number in steps of a unit."""
    return Coding(
        method=_linear(0.0, resolution),
        coded_type=standard_type("A_UINT32", 8 * size_bytes),
        physical_type=node("PHYSICAL-TYPE", {"BASE-DATA-TYPE": "A_FLOAT64"}),
        unit=unit,
    )


def worded(meanings: Mapping[int, str], bits: int, *, has_others: bool = False) -> Coding:
    """Return the coding of a number that stands for a text; ``has_others``: some numbers may stand for none."""
    scales = [_meaning(number, text) for number, text in sorted(meanings.items())]
    rest = node("COMPU-INVERSE-VALUE", node("V", str((1 << bits) - 1)))
    default = node("COMPU-DEFAULT-VALUE", node("VT", UNDEFINED), rest) if has_others else None
    method = node(
        "COMPU-METHOD",
        node("CATEGORY", "TEXTTABLE"),
        node("COMPU-INTERNAL-TO-PHYS", node("COMPU-SCALES", *scales), default),
    )
    return Coding(method=method, coded_type=standard_type("A_UINT32", bits), physical_type=_text_type())


def raw(size_bytes: int) -> Coding:
    """Return the coding of so many bytes."""
    return _bytes(standard_type("A_BYTEFIELD", 8 * size_bytes))


def rest(least_bytes: int) -> Coding:
    """Return the coding of all bytes that are left."""
    attributes = {"BASE-DATA-TYPE": "A_BYTEFIELD", "TERMINATION": "END-OF-PDU", "xsi:type": "MIN-MAX-LENGTH-TYPE"}
    return _bytes(node("DIAG-CODED-TYPE", attributes, node("MIN-LENGTH", str(least_bytes))))


def described(entry: Field) -> Coding:
    """Return the coding of a field of the table."""
    bits = 8 * entry.size_bytes
    if entry.kind is Kind.TEXT:
        coded_type = standard_type("A_ASCIISTRING", bits, "ISO-8859-1")
        return Coding(method=_identical(), coded_type=coded_type, physical_type=_text_type())
    if entry.kind is Kind.FLOAT:
        return _floating(entry)
    if entry.kind is Kind.BYTES or entry.size_bytes > LONGEST_NUMBER_BYTES:
        return raw(entry.size_bytes)
    if entry.meanings:
        return worded(entry.numbered_meanings, bits, has_others=True)
    is_signed = entry.kind is Kind.SIGNED
    data_type = "A_INT32" if is_signed else "A_UINT32"
    is_plain = entry.resolution == 1.0 and entry.offset == 0.0
    return Coding(
        method=_identical() if is_plain else _linear(entry.offset, entry.resolution),
        coded_type=standard_type(data_type, bits, "2C" if is_signed else ""),
        physical_type=node("PHYSICAL-TYPE", {"BASE-DATA-TYPE": data_type if is_plain else "A_FLOAT64"}),
        constraint=_not_available(entry) if entry.source else None,
        unit=entry.unit,
        physical_constraint=_between(entry, is_whole=is_plain),
    )


def remark(entry: Field) -> str:
    """Return what ODX cannot say of a field in its own words."""
    if entry.pattern:
        return f"As a regular expression: {entry.pattern}"
    if entry.kind is Kind.FLOAT:
        return "IEEE 754, high byte first; what is not a number is not available."
    if entry.kind in {Kind.TEXT, Kind.BYTES} or entry.size_bytes <= LONGEST_NUMBER_BYTES:
        return ""
    return (
        f"A number ({entry.kind}, high byte first): {entry.resolution!r} {entry.unit} a step, beginning at "
        f"{entry.offset!r}; ODX has no number of {entry.size_bytes} bytes."
    )


def _floating(entry: Field) -> Coding:
    data_type = f"A_FLOAT{8 * entry.size_bytes}"
    return Coding(
        method=_identical(),
        coded_type=standard_type(data_type, 8 * entry.size_bytes),
        physical_type=node("PHYSICAL-TYPE", {"BASE-DATA-TYPE": data_type}),
        unit=entry.unit,
        physical_constraint=_between(entry, is_whole=False),
    )


def _bytes(coded_type: Element) -> Coding:
    physical_type = node("PHYSICAL-TYPE", {"BASE-DATA-TYPE": "A_BYTEFIELD"})
    return Coding(method=_identical(), coded_type=coded_type, physical_type=physical_type)


def _text_type() -> Element:
    return node("PHYSICAL-TYPE", {"BASE-DATA-TYPE": "A_UNICODE2STRING"})


def _identical() -> Element:
    return node("COMPU-METHOD", node("CATEGORY", "IDENTICAL"))


def _linear(offset: float, factor: float) -> Element:
    coefficients = node(
        "COMPU-RATIONAL-COEFFS",
        node("COMPU-NUMERATOR", node("V", repr(offset)), node("V", repr(factor))),
        node("COMPU-DENOMINATOR", node("V", "1")),
    )
    scales = node("COMPU-SCALES", node("COMPU-SCALE", coefficients))
    return node("COMPU-METHOD", node("CATEGORY", "LINEAR"), node("COMPU-INTERNAL-TO-PHYS", scales))


def _meaning(number: int, text: str) -> Element:
    limits = node("LOWER-LIMIT", str(number)), node("UPPER-LIMIT", str(number))
    return node("COMPU-SCALE", *limits, node("COMPU-CONST", node("VT", text)))


def _not_available(entry: Field) -> Element:
    number = str(not_available(entry))
    limits = node("LOWER-LIMIT", number), node("UPPER-LIMIT", number)
    return node("INTERNAL-CONSTR", node("SCALE-CONSTRS", node("SCALE-CONSTR", {"VALIDITY": "NOT-AVAILABLE"}, *limits)))


def _between(entry: Field, *, is_whole: bool) -> Element | None:
    limits = [
        node(tag, str(round(limit)) if is_whole else repr(limit))
        for tag, limit in (("LOWER-LIMIT", entry.minimum), ("UPPER-LIMIT", entry.maximum))
        if limit is not None
    ]
    return listed("PHYS-CONSTR", *limits)
