"""Parameters of requests, responses and structures, each at its place."""

from dataclasses import dataclass
from xml.etree.ElementTree import Element

from ecu_emulator.diagnostics.pdx.coded_types import standard_type
from ecu_emulator.diagnostics.pdx.elements import Names, node, reference, title


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One parameter: a constant, a value, or bytes of the request that come back."""

    name: str
    size_bytes: int | None  # of fixed length, or not
    constant: int | None = None
    data: str = ""  # name of what describes a value
    request_place: int | None = None
    semantic: str = "DATA"
    bit: int | None = None  # of the byte before; a value of one bit

    def element(self, name: str, place: int | None) -> Element:
        """Return the PARAM at a byte position, or after what is before it."""
        return node(
            "PARAM",
            {"SEMANTIC": self.semantic, "xsi:type": self._kind},
            *title(name, self.name if name != self.name else ""),
            None if place is None else node("BYTE-POSITION", str(place)),
            None if self.bit is None else node("BIT-POSITION", str(self.bit)),
            *self._content(),
        )

    @property
    def _kind(self) -> str:
        if self.constant is not None:
            return "CODED-CONST"
        return "VALUE" if self.request_place is None else "MATCHING-REQUEST-PARAM"

    def _content(self) -> tuple[Element, ...]:
        if self.constant is not None:
            bits = 8 * (self.size_bytes or 0)
            return node("CODED-VALUE", str(self.constant)), standard_type("A_UINT32", bits)
        if self.request_place is not None:
            return node("REQUEST-BYTE-POS", str(self.request_place)), node("BYTE-LENGTH", str(self.size_bytes))
        return (reference("DOP-REF", "DOP", self.data),)


def constant(name: str, value: int, size_bytes: int = 1, semantic: str = "DATA") -> Parameter:
    """Return a parameter that is always the same."""
    return Parameter(name=name, size_bytes=size_bytes, constant=value, semantic=semantic)


def service_id(number: int) -> Parameter:
    """Return the parameter that begins a message."""
    return constant("service", number, semantic="SERVICE-ID")


def sub_function(number: int) -> Parameter:
    """Return the parameter whose upper bit suppresses a positive response."""
    return constant("sub_function", number, semantic="SUBFUNCTION")


def value(name: str, data: str, size_bytes: int | None = None) -> Parameter:
    """Return a parameter that a data object or structure describes."""
    return Parameter(name=name, size_bytes=size_bytes, data=data)


def echo(name: str, place: int, size_bytes: int) -> Parameter:
    """Return a parameter that repeats bytes of the request."""
    return Parameter(name=name, size_bytes=size_bytes, request_place=place)


def placed(parameters: tuple[Parameter, ...]) -> Element:
    """Return the PARAMS of a message or structure: with positions for as long as they are known."""
    names, place, made = Names(), 0, list[Element]()
    is_known = True
    for entry in parameters:
        made.append(entry.element(names.new(entry.name), place if is_known else None))
        if entry.size_bytes is None:
            is_known = False
        elif entry.bit is None or entry.bit == 7:
            place += entry.size_bytes
    return node("PARAMS", *made)
