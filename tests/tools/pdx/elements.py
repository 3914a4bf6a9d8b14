"""Elements of ODX as odxtools has them: named, numbered and coded as its schema wants."""

import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from html import escape
from typing import Any, Final, TypeAlias

from odxtools.compumethods.compucategory import CompuCategory
from odxtools.compumethods.compuconst import CompuConst
from odxtools.compumethods.compudefaultvalue import CompuDefaultValue
from odxtools.compumethods.compuinternaltophys import CompuInternalToPhys
from odxtools.compumethods.compuinversevalue import CompuInverseValue
from odxtools.compumethods.compumethod import CompuMethod
from odxtools.compumethods.compurationalcoeffs import CompuRationalCoeffs
from odxtools.compumethods.compuscale import CompuScale
from odxtools.compumethods.identicalcompumethod import IdenticalCompuMethod
from odxtools.compumethods.limit import Limit
from odxtools.compumethods.linearcompumethod import LinearCompuMethod
from odxtools.compumethods.texttablecompumethod import TexttableCompuMethod
from odxtools.dataobjectproperty import DataObjectProperty
from odxtools.description import Description
from odxtools.determinenumberofitems import DetermineNumberOfItems
from odxtools.diagcodedtype import DiagCodedType
from odxtools.diagdatadictionaryspec import DiagDataDictionarySpec
from odxtools.diagnostictroublecode import DiagnosticTroubleCode
from odxtools.dtcdop import DtcDop
from odxtools.dynamiclengthfield import DynamicLengthField
from odxtools.encoding import Encoding
from odxtools.endofpdufield import EndOfPduField
from odxtools.internalconstr import InternalConstr
from odxtools.minmaxlengthtype import MinMaxLengthType
from odxtools.multiplexer import Multiplexer
from odxtools.multiplexercase import MultiplexerCase
from odxtools.multiplexerdefaultcase import MultiplexerDefaultCase
from odxtools.multiplexerswitchkey import MultiplexerSwitchKey
from odxtools.nameditemlist import NamedItemList
from odxtools.odxlink import DocType, OdxDocFragment, OdxLinkId, OdxLinkRef
from odxtools.odxtypes import DataType
from odxtools.parameters.codedconstparameter import CodedConstParameter
from odxtools.parameters.matchingrequestparameter import MatchingRequestParameter
from odxtools.parameters.parameter import Parameter
from odxtools.parameters.valueparameter import ValueParameter
from odxtools.physicaltype import PhysicalType
from odxtools.radix import Radix
from odxtools.scaleconstr import ScaleConstr
from odxtools.standardlengthtype import StandardLengthType
from odxtools.structure import Structure
from odxtools.termination import Termination
from odxtools.text import Text
from odxtools.unit import Unit
from odxtools.unitspec import UnitSpec
from odxtools.validtype import ValidType

from workshop.controller.descriptions import Coding, DatumField, Trouble, not_available

LONGEST_NUMBER_BYTES: Final = 4  # ODX has no longer whole numbers
UNDEFINED: Final = "undefined"  # the meaning of a number that has none
UNSIGNED, SIGNED, REAL = DataType.A_UINT32, DataType.A_INT32, DataType.A_FLOAT64
TEXT, BYTES = DataType.A_UNICODE2STRING, DataType.A_BYTEFIELD
HEXADECIMAL: Final = PhysicalType(base_data_type=UNSIGNED, display_radix=Radix.HEX)
_NOT_IN_NAMES: Final = re.compile(r"[^A-Za-z0-9_]+")
_NOT_IN_XML: Final = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_LONGEST_NAME: Final = 100  # of 128 that ODX allows; what makes a name unique comes on top
Part: TypeAlias = tuple[Parameter, int | None]  # without its place yet; its bytes, None: not always as many
Parts: TypeAlias = tuple[Part, ...]


def short_name(text: str) -> str:
    """Return a text as ODX allows it for a name."""
    return _NOT_IN_NAMES.sub("_", text).strip("_")[:_LONGEST_NAME] or "unnamed"


def xml_text(text: str) -> str:
    """Return a text without characters that XML does not have."""
    return _NOT_IN_XML.sub("?", text)


class Names:
    """Names that were given, so that none is given twice; tools may take upper and lower case for the same."""

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def new(self, text: str) -> str:
        """Return a name like this one that nothing else has."""
        wanted = short_name(text)
        name, count = wanted, 1
        while name.lower() in self._taken:
            count += 1
            name = f"{wanted}_{count}"
        self._taken.add(name.lower())
        return name


class Document:
    """A file of ODX: what is named in it can be referred to by its kind and name."""

    def __init__(self, name: str, kind: DocType) -> None:
        self._fragment = OdxDocFragment(name, kind)

    def named(self, kind: str, name: str, long_name: str = "", text: str = "") -> dict[str, Any]:
        """Return what every named element of odxtools is made with."""
        told = Description(text=f"<p>{escape(xml_text(text))}</p>") if text else None
        long = xml_text(long_name) if long_name and long_name != name else None
        odx_id = OdxLinkId(f"{kind}.{name}", (self._fragment,))
        return {"short_name": name, "long_name": long, "description": told, "odx_id": odx_id}

    def ref(self, kind: str, name: str) -> OdxLinkRef:
        return OdxLinkRef(f"{kind}.{name}", (self._fragment,))


def constant(name: str, number: int, size_bytes: int = 1, semantic: str = "DATA") -> Part:
    """Return a parameter that is always the same."""
    coding = coded(UNSIGNED, 8 * size_bytes)
    raw_value = str(number)
    made = CodedConstParameter(short_name=name, semantic=semantic, coded_value_raw=raw_value, diag_coded_type=coding)
    return made, size_bytes


def value(name: str, data: OdxLinkRef, size_bytes: int | None = None, bit: int | None = None) -> Part:
    """Return a parameter that a data object or structure describes."""
    return ValueParameter(short_name=name, semantic="DATA", dop_ref=data, bit_position=bit), size_bytes


def echo(name: str, place: int, size_bytes: int) -> Part:
    """Return a parameter that repeats bytes of the request."""
    made = MatchingRequestParameter(
        short_name=name, semantic="DATA", request_byte_position=place, byte_length=size_bytes
    )
    return made, size_bytes


def placed(parts: Parts) -> NamedItemList[Parameter]:
    """Return the parameters of a message or structure: with positions for as long as they are known."""
    names, made, place = Names(), NamedItemList[Parameter](), 0
    position: int | None = 0
    for entry, size_bytes in parts:
        name = names.new(entry.short_name)
        long_name = xml_text(entry.short_name) if entry.short_name != name else None
        made.append(replace(entry, short_name=name, long_name=long_name, byte_position=position))
        place += size_bytes or 0 if entry.bit_position in {None, 7} else 0
        position = None if size_bytes is None or position is None else place
    return made


def coded(data_type: DataType, bits: int, encoding: Encoding | None = None) -> StandardLengthType:
    """Return the type of a value of fixed length."""
    return StandardLengthType(base_data_type=data_type, bit_length=bits, base_type_encoding=encoding)


def unsigned(size_bytes: int, *, is_hexadecimal: bool = False) -> DataObjectProperty:
    """Return the coding of a plain number."""
    made = _coding(coded(UNSIGNED, 8 * size_bytes), UNSIGNED)
    return replace(made, physical_type=HEXADECIMAL) if is_hexadecimal else made


def scaled(size_bytes: int, resolution: float) -> DataObjectProperty:
    """Return the coding of a number in steps of a unit."""
    return _coding(coded(UNSIGNED, 8 * size_bytes), REAL, _linear(UNSIGNED, 0.0, resolution))


def worded(meanings: Mapping[int, str], bits: int = 8, *, has_others: bool = False) -> DataObjectProperty:
    """Return the coding of a number that stands for a text; ``has_others``: some numbers may stand for none."""
    types: dict[str, Any] = {"domain_type": UNSIGNED, "range_type": TEXT}
    scales = [
        CompuScale(**_only(number, UNSIGNED), compu_const=CompuConst(vt=xml_text(text), data_type=TEXT), **types)
        for number, text in sorted(meanings.items())
    ]
    inverse = CompuInverseValue(v=str((1 << bits) - 1), data_type=UNSIGNED)
    other = CompuDefaultValue(vt=UNDEFINED, data_type=TEXT, compu_inverse_value=inverse) if has_others else None
    to_text = CompuInternalToPhys(compu_scales=scales, compu_default_value=other)
    made = TexttableCompuMethod(
        category=CompuCategory.TEXTTABLE, compu_internal_to_phys=to_text, internal_type=UNSIGNED, physical_type=TEXT
    )
    return _coding(coded(UNSIGNED, bits), TEXT, made)


def raw(size_bytes: int) -> DataObjectProperty:
    return _coding(coded(BYTES, 8 * size_bytes), BYTES)


def rest(least_bytes: int) -> DataObjectProperty:
    """Return the coding of all bytes that are left."""
    end = Termination.END_OF_PDU
    return _coding(MinMaxLengthType(base_data_type=BYTES, min_length=least_bytes, termination=end), BYTES)


def described(entry: DatumField) -> DataObjectProperty:
    """Return the coding of a field of the table."""
    bits = 8 * entry.size_bytes
    if entry.kind is Coding.TEXT:
        return _coding(coded(DataType.A_ASCIISTRING, bits, Encoding.ISO_8859_1), TEXT)
    if entry.kind is Coding.FLOAT:
        real = DataType(f"A_FLOAT{bits}")
        return replace(_coding(coded(real, bits), real), physical_constr=_between(entry, real))
    if entry.kind is Coding.BYTES or entry.size_bytes > LONGEST_NUMBER_BYTES:
        return raw(entry.size_bytes)
    if entry.meanings:
        return worded(entry.numbered_meanings, bits, has_others=True)
    is_signed, is_plain = entry.kind is Coding.SIGNED, entry.resolution == 1.0 and entry.offset == 0.0
    number = SIGNED if is_signed else UNSIGNED
    physical = number if is_plain else REAL
    method = None if is_plain else _linear(number, entry.offset, entry.resolution)
    made = _coding(coded(number, bits, Encoding.TWOC if is_signed else None), physical, method)
    missing = _not_available(entry, number) if entry.source else None
    return replace(made, internal_constr=missing, physical_constr=_between(entry, physical))


def remark(entry: DatumField) -> str:
    """Return what ODX cannot say of a field in its own words."""
    if entry.pattern:
        return f"As a regular expression: {entry.pattern}"
    if entry.kind is Coding.FLOAT:
        return "IEEE 754, high byte first; what is not a number is not available."
    if entry.kind in {Coding.TEXT, Coding.BYTES} or entry.size_bytes <= LONGEST_NUMBER_BYTES:
        return ""
    return (
        f"A number ({entry.kind}, high byte first): {entry.resolution!r} {entry.unit} a step, beginning at "
        f"{entry.offset!r}; ODX has no number of {entry.size_bytes} bytes."
    )


def _has_unit(entry: DatumField) -> bool:
    is_number = entry.kind in {Coding.UNSIGNED, Coding.SIGNED} and entry.size_bytes <= LONGEST_NUMBER_BYTES
    return bool(entry.unit) and (entry.kind is Coding.FLOAT or (is_number and not entry.meanings))


def _coding(coded_type: DiagCodedType, physical: DataType, method: CompuMethod | None = None) -> DataObjectProperty:
    """Return a coding to which a dictionary gives its name."""
    same, number = CompuCategory.IDENTICAL, coded_type.base_data_type
    return DataObjectProperty(
        **Document("", DocType.CONTAINER).named("", ""), diag_coded_type=coded_type,
        compu_method=method or IdenticalCompuMethod(category=same, internal_type=number, physical_type=physical),
        physical_type=PhysicalType(base_data_type=physical),
    )  # fmt: skip


def _linear(number: DataType, offset: float, factor: float) -> CompuMethod:
    coefficients = CompuRationalCoeffs(value_type=REAL, numerators=[offset, factor], denominators=[1])
    scale = CompuScale(compu_rational_coeffs=coefficients, domain_type=number, range_type=REAL)
    line = CompuInternalToPhys(compu_scales=[scale])
    return LinearCompuMethod(
        category=CompuCategory.LINEAR, compu_internal_to_phys=line, internal_type=number, physical_type=REAL
    )


def _limit(number: float, data_type: DataType) -> Limit:
    text = repr(float(number)) if data_type not in {UNSIGNED, SIGNED} else str(round(number))
    return Limit(value_raw=text, value_type=data_type)


def _only(number: int, data_type: DataType) -> dict[str, Any]:
    """Return both limits of a range that is one number."""
    return {"lower_limit": _limit(number, data_type), "upper_limit": _limit(number, data_type)}


def _not_available(entry: DatumField, number: DataType) -> InternalConstr:
    missing = ScaleConstr(validity=ValidType.NOT_AVAILABLE, value_type=number, **_only(not_available(entry), number))
    return InternalConstr(scale_constrs=[missing], value_type=number)


def _between(entry: DatumField, physical: DataType) -> InternalConstr | None:
    if entry.minimum is None and entry.maximum is None:
        return None
    lower, upper = (None if limit is None else _limit(limit, physical) for limit in (entry.minimum, entry.maximum))
    return InternalConstr(lower_limit=lower, upper_limit=upper, value_type=physical)


class Dictionary(Document):
    """Collects what parameters are made of, each described once; methods return by what a parameter refers to it."""

    def __init__(self, container: str) -> None:
        super().__init__(container, DocType.CONTAINER)
        self._names, self._unit_names = Names(), Names()
        self._parts: dict[str, Any] = defaultdict(NamedItemList)
        self._units: dict[str, Unit] = {}

    def spec(self) -> DiagDataDictionarySpec:
        units = UnitSpec(units=NamedItemList(self._units.values())) if self._units else None
        return DiagDataDictionarySpec(unit_spec=units, **self._parts)

    def simple(self, name: str, coding: DataObjectProperty, text: str = "", unit: str = "") -> OdxLinkRef:
        unit_ref = self._unit(unit) if unit else None
        named = self.named("DOP", self._names.new(name), name, text)
        return self._add("data_object_props", replace(coding, **named, unit_ref=unit_ref))

    def structure(self, name: str, parts: Parts, long_name: str = "") -> OdxLinkRef:
        """Describe several values one after the other."""
        return self._add("structures", Structure(**self._new(name, long_name), parameters=placed(parts)))

    def fields(self, name: str, entries: tuple[DatumField, ...]) -> OdxLinkRef:
        """Describe fields of the table as a structure."""
        return self.structure(name, self.field_parts(name, entries), name)

    def field_parts(self, name: str, entries: tuple[DatumField, ...]) -> Parts:
        """Describe fields of the table, one parameter each."""
        made = list[Part]()
        for entry in entries:
            unit = entry.unit if _has_unit(entry) else ""
            data = self.simple(f"{name} {entry.name}", described(entry), remark(entry), unit)
            made.append(value(entry.name, data, entry.size_bytes))
        return tuple(made)

    def flags(self, name: str, names: tuple[str, ...]) -> OdxLinkRef:
        """Describe a byte of flags, lowest bit first."""
        flag = self.simple(f"{name} bit", worded({0: "no", 1: "yes"}, 1))
        return self.structure(name, tuple(value(entry, flag, 1, bit) for bit, entry in enumerate(names)))

    def repeated(self, name: str, structure: OdxLinkRef, most: int | None = None, least: int = 0) -> OdxLinkRef:
        """Describe a structure that comes again until the message ends."""
        count: dict[str, Any] = {"max_number_of_items": most, "min_number_of_items": least}
        return self._add("end_of_pdu_fields", EndOfPduField(**self._new(name), structure_ref=structure, **count))

    def counted(self, name: str, structure: OdxLinkRef, count: OdxLinkRef) -> OdxLinkRef:
        """Describe a structure that comes as often as the byte before it says."""
        number: dict[str, Any] = {"determine_number_of_items": DetermineNumberOfItems(byte_position=0, dop_ref=count)}
        made = DynamicLengthField(**self._new(name), structure_ref=structure, offset=1, **number)
        return self._add("dynamic_length_fields", made)

    def switched(
        self, name: str, key: Part, cases: Mapping[int, OdxLinkRef], other: OdxLinkRef | None = None
    ) -> OdxLinkRef:
        """Describe a number that says which structure follows; ``other`` follows all numbers that are no case."""
        made = NamedItemList(
            MultiplexerCase(short_name=ref.ref_id.removeprefix("DOP."), structure_ref=ref, **_only(number, UNSIGNED))
            for number, ref in cases.items()
        )
        default = None if other is None else MultiplexerDefaultCase(short_name="other", structure_ref=other)
        switch = MultiplexerSwitchKey(byte_position=0, dop_ref=vars(key[0])["dop_ref"])
        kinds: dict[str, Any] = {"byte_position": key[1], "switch_key": switch, "default_case": default, "cases": made}
        return self._add("muxs", Multiplexer(**self._new(name), **kinds))

    def code_part(self, parameter: str, name: str, troubles: tuple[Trouble, ...], size_bytes: int) -> Part:
        """Describe trouble codes of three bytes, the last of which is the failure type, or of two, as OBD has them."""
        names, coding = Names(), unsigned(size_bytes, is_hexadecimal=True)
        if not troubles:
            return value(parameter, self.simple(name, coding), size_bytes)
        made = DtcDop(
            **self._new(name), diag_coded_type=coding.diag_coded_type, physical_type=coding.physical_type,
            compu_method=coding.compu_method,
            dtcs_raw=[self._code(entry, names, is_short=size_bytes == 2) for entry in troubles],
        )  # fmt: skip
        return value(parameter, self._add("dtc_dops", made), size_bytes)

    def _code(self, trouble: Trouble, names: Names, *, is_short: bool) -> DiagnosticTroubleCode:
        failure = "" if is_short else f"{trouble.failure_type:02X}"
        return DiagnosticTroubleCode(
            **self.named("DTC", names.new(f"{trouble.code}_{failure}")),
            trouble_code=trouble.number >> 8 if is_short else trouble.number,
            display_trouble_code=f"{trouble.code}-{failure}".rstrip("-"),
            text=Text(text=xml_text(trouble.text)),
            level=None if is_short else trouble.severity,
        )

    def _unit(self, unit: str) -> OdxLinkRef:
        if unit not in self._units:
            name = self._unit_names.new(unit.replace("%", "percent"))
            self._units[unit] = Unit(**self.named("UNIT", name), display_name=xml_text(unit))
        return self.ref("UNIT", self._units[unit].short_name)

    def _new(self, name: str, long_name: str = "") -> dict[str, Any]:
        return self.named("DOP", self._names.new(name), long_name)

    def _add(self, kind: str, made: Any) -> OdxLinkRef:  # noqa: ANN401 - classes without a common one
        self._parts[kind].append(made)
        return self.ref("DOP", made.short_name)
