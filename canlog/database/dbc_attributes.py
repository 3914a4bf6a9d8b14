"""Attributes of DBC files: values that are not defined, or not of the kind that their definition says."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from types import MappingProxyType
from typing import Final

WHOLE_KINDS: Final = frozenset({"INT", "HEX", "ENUM"})
NUMBER_KINDS: Final = frozenset({"INT", "HEX", "FLOAT"})
FRAME_FORMATS: Final = 16  # that CAN FD and J1939 databases tell apart
TEXT: Final = "STRING"
# Attributes that mean something, and of which kinds they may be.
KINDS: Final[Mapping[str, frozenset[str]]] = MappingProxyType(
    {
        "SPN": WHOLE_KINDS,
        "GenSigStartValue": WHOLE_KINDS | {"FLOAT"},
        "DBName": frozenset({TEXT}),
        "VFrameFormat": frozenset({"INT", "ENUM"}),
        "Baudrate": WHOLE_KINDS | {"FLOAT"},
    }
)
OWNERS: Final = frozenset({"SG_", "BO_", "EV_", "BU_", "BU_SG_REL_", "BU_BO_REL_", "BU_EV_REL_"})
CHOSEN: Final = frozenset({"GenMsgSendType", "VFrameFormat"})  # whose value is the place of a choice


@dataclass(frozen=True, slots=True, kw_only=True)
class _Definition:
    kind: str
    choices: int


@dataclass(slots=True)
class AttributeRules:
    """What a file defines, and whether values keep to it."""

    _defined: dict[str, _Definition] = field(default_factory=dict)
    _related: dict[str, _Definition] = field(default_factory=dict)

    def define(self, words: list[str]) -> str:
        """Take up a definition; return what is wrong with it, empty if nothing is."""
        at = 2 if words[1] in OWNERS else 1
        name, kind = words[at : at + 2]
        values = [value for value in words[at + 2 : -1] if value != ","]
        if kind in NUMBER_KINDS and values:
            if len(values) < 2:
                return "its range has one end only"
            if cause := wrong_number(kind, values[0]) or wrong_number(kind, values[1]):
                return cause
        if kind not in KINDS.get(name, {kind}):
            return f"the attribute {name} cannot be of the kind {kind}"
        table = self._related if words[0] == "BA_DEF_REL_" else self._defined
        table[name] = _Definition(kind=kind, choices=len(values) if kind == "ENUM" else 0)
        return ""

    def check_default(self, words: list[str]) -> str:
        """Return what is wrong with a default value; empty if nothing is."""
        definition = (self._related if words[0] == "BA_DEF_DEF_REL_" else self._defined).get(words[1])
        if definition is None or definition.kind not in NUMBER_KINDS:
            return ""
        return wrong_number(definition.kind, words[2])

    def check_value(self, words: list[str]) -> str:
        """Return what is wrong with the value of an attribute; empty if nothing is."""
        definition = (self._related if words[0] == "BA_REL_" else self._defined).get(words[1])
        if definition is None:
            return f"the attribute {words[1]} is not defined"
        owners = [words[at + 1] for at, word in enumerate(words) if word in {"BO_", "SG_"}]
        if not all(owner.isascii() and owner.isdecimal() for owner in owners):
            return "the identifier must be a whole number"
        return wrong_value(words[1], definition, words[-2])


def wrong_value(name: str, definition: _Definition, value: str) -> str:
    """Return what is wrong with a value; empty if nothing is."""
    if definition.kind in WHOLE_KINDS | {"FLOAT"} and (cause := wrong_number(definition.kind, value)):
        return cause
    choices = FRAME_FORMATS if name == "VFrameFormat" and definition.kind == "INT" else definition.choices
    if name in CHOSEN and choices and not 0 <= int(Decimal(value)) < choices:
        return f"its value is not one of the {choices} choices"
    return ""


def wrong_number(kind: str, value: str) -> str:
    """Return why a text is no number of some kind; empty if it is one."""
    try:
        number = Decimal(value)
    except InvalidOperation:
        return f"{value[:20]!r} is not a number, as the kind {kind} asks for"
    return "" if number.is_finite() and abs(number) < Decimal(10) ** 30 else "its value is not a usable number"
