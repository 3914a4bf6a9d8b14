"""The data dictionary of a controller: what its parameters are made of, each described once."""

from collections.abc import Mapping
from xml.etree.ElementTree import Element

from ecu_emulator.diagnostics.descriptions import Field, Trouble
from ecu_emulator.diagnostics.pdx.coded_types import Coding, described, remark, standard_type, worded
from ecu_emulator.diagnostics.pdx.elements import Names, listed, named, node, reference, title
from ecu_emulator.diagnostics.pdx.parameters import Parameter, placed, value


class Dictionary:
    """Collects what is described; every method returns the name by which a parameter refers to it."""

    def __init__(self) -> None:
        self._names = Names()
        self._unit_names = Names()
        self._codes: list[Element] = []
        self._simple: list[Element] = []
        self._structures: list[Element] = []
        self._counted: list[Element] = []
        self._repeated: list[Element] = []
        self._switched: list[Element] = []
        self._units: dict[str, Element] = {}
        self._unit_ids: dict[str, str] = {}

    def simple(self, name: str, coding: Coding, text: str = "") -> str:
        """Describe one value."""
        short = self._names.new(name)
        made = named("DATA-OBJECT-PROP", "DOP", short, name if short != name else "", text)
        unit = reference("UNIT-REF", "UNIT", self._unit(coding.unit)) if coding.unit else None
        parts = (coding.method, coding.coded_type, coding.physical_type, coding.constraint, unit)
        made.extend(part for part in (*parts, coding.physical_constraint) if part is not None)
        self._simple.append(made)
        return short

    def structure(self, name: str, parameters: tuple[Parameter, ...], long_name: str = "") -> str:
        """Describe several values one after the other."""
        short = self._names.new(name)
        made = named("STRUCTURE", "DOP", short, long_name)
        made.append(placed(parameters))
        self._structures.append(made)
        return short

    def fields(self, name: str, entries: tuple[Field, ...]) -> str:
        """Describe fields of the table as a structure."""
        return self.structure(name, self.field_parameters(name, entries), name)

    def field_parameters(self, name: str, entries: tuple[Field, ...]) -> tuple[Parameter, ...]:
        """Describe fields of the table, one parameter each."""
        return tuple(
            value(entry.name, self.simple(f"{name} {entry.name}", described(entry), remark(entry)), entry.size_bytes)
            for entry in entries
        )

    def flags(self, name: str, names: tuple[str, ...]) -> str:
        """Describe a byte of flags, lowest bit first."""
        bit = self.simple(f"{name} bit", worded({0: "no", 1: "yes"}, 1))
        return self.structure(
            name,
            tuple(Parameter(name=entry, size_bytes=1, data=bit, bit=place) for place, entry in enumerate(names)),
        )

    def repeated(self, name: str, structure: str, most: int | None = None, least: int = 0) -> str:
        """Describe a structure that comes again until the message ends."""
        short = self._names.new(name)
        made = named("END-OF-PDU-FIELD", "DOP", short)
        made.append(reference("BASIC-STRUCTURE-REF", "DOP", structure))
        if most is not None:
            made.append(node("MAX-NUMBER-OF-ITEMS", str(most)))
        made.append(node("MIN-NUMBER-OF-ITEMS", str(least)))
        self._repeated.append(made)
        return short

    def counted(self, name: str, structure: str, count: str) -> str:
        """Describe a structure that comes as often as the byte before it says."""
        short = self._names.new(name)
        made = named("DYNAMIC-LENGTH-FIELD", "DOP", short)
        number = node(
            "DETERMINE-NUMBER-OF-ITEMS",
            node("BYTE-POSITION", "0"),
            reference("DATA-OBJECT-PROP-REF", "DOP", count),
        )
        made.extend((reference("BASIC-STRUCTURE-REF", "DOP", structure), node("OFFSET", "1"), number))
        self._counted.append(made)
        return short

    def switched(self, name: str, key: str, key_bytes: int, cases: Mapping[int, str], other: str = "") -> str:
        """Describe a number that says which structure follows; ``other`` follows all numbers that are no case."""
        short = self._names.new(name)
        made = named("MUX", "DOP", short)
        switch = node("SWITCH-KEY", node("BYTE-POSITION", "0"), reference("DATA-OBJECT-PROP-REF", "DOP", key))
        made.extend((node("BYTE-POSITION", str(key_bytes)), switch))
        if other:
            made.append(node("DEFAULT-CASE", *title("other"), reference("STRUCTURE-REF", "DOP", other)))
        entries = listed("CASES", *(_case(number, structure) for number, structure in cases.items()))
        if entries is not None:
            made.append(entries)
        self._switched.append(made)
        return short

    def codes(self, name: str, troubles: tuple[Trouble, ...]) -> str:
        """Describe trouble codes of three bytes, the last of which is the failure type."""
        names = Names()
        return self._trouble_codes(name, 24, [_code(entry, names) for entry in troubles])

    def short_codes(self, name: str, troubles: tuple[Trouble, ...]) -> str:
        """Describe trouble codes of two bytes, as OBD has them; each once."""
        return self._trouble_codes(name, 16, [_short_code(entry) for entry in troubles])

    def _trouble_codes(self, name: str, bits: int, codes: list[Element]) -> str:
        short = self._names.new(name)
        made = named("DTC-DOP", "DOP", short)
        made.extend(
            (
                standard_type("A_UINT32", bits),
                node("PHYSICAL-TYPE", {"BASE-DATA-TYPE": "A_UINT32", "DISPLAY-RADIX": "HEX"}),
                node("COMPU-METHOD", node("CATEGORY", "IDENTICAL")),
                node("DTCS", *codes),
            )
        )
        self._codes.append(made)
        return short

    def element(self) -> Element:
        """Return all of it."""
        units = node("UNIT-SPEC", node("UNITS", *self._units.values())) if self._units else None
        return node(
            "DIAG-DATA-DICTIONARY-SPEC",
            listed("DTC-DOPS", *self._codes),
            listed("DATA-OBJECT-PROPS", *self._simple),
            listed("STRUCTURES", *self._structures),
            listed("DYNAMIC-LENGTH-FIELDS", *self._counted),
            listed("END-OF-PDU-FIELDS", *self._repeated),
            listed("MUXS", *self._switched),
            units,
        )

    def _unit(self, unit: str) -> str:
        if unit not in self._unit_ids:
            short = self._unit_names.new(unit.replace("%", "percent"))
            made = named("UNIT", "UNIT", short)
            made.append(node("DISPLAY-NAME", unit))
            self._unit_ids[unit], self._units[unit] = short, made
        return self._unit_ids[unit]


def _case(number: int, structure: str) -> Element:
    limits = node("LOWER-LIMIT", str(number)), node("UPPER-LIMIT", str(number))
    return node("CASE", *title(structure), reference("STRUCTURE-REF", "DOP", structure), *limits)


def _code(trouble: Trouble, names: Names) -> Element:
    short = names.new(f"{trouble.code}_{trouble.failure_type:02X}")
    return node(
        "DTC",
        {"ID": f"DTC.{short}"},
        node("SHORT-NAME", short),
        node("TROUBLE-CODE", str(trouble.number)),
        node("DISPLAY-TROUBLE-CODE", f"{trouble.code}-{trouble.failure_type:02X}"),
        node("TEXT", trouble.text),
        node("LEVEL", str(trouble.severity)),
    )


def _short_code(trouble: Trouble) -> Element:
    return node(
        "DTC",
        {"ID": f"DTC.{trouble.code}"},
        node("SHORT-NAME", trouble.code),
        node("TROUBLE-CODE", str(trouble.number >> 8)),
        node("DISPLAY-TROUBLE-CODE", trouble.code),
        node("TEXT", trouble.text),
    )
