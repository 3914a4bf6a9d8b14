"""How a tool reaches the controller: communication parameters as ISO 22900-2 names them, and their values."""

from dataclasses import dataclass
from typing import Final
from xml.etree.ElementTree import Element

from ecu_emulator.diagnostics.pdx.elements import named, node, reference, title
from ecu_emulator.diagnostics.table import DiagnosticTable

SPECIFICATION: Final = "ISO_15765_3_on_ISO_15765_2"
PHYSICAL_LINK: Final = "ISO_11898_2_DWCAN"
TRANSPORT: Final = "ISO_15765_2"
APPLICATION: Final = "ISO_15765_3"
LARGEST_STANDARD_ID: Final = 0x7FF
_US_PER_S: Final = 1e6
_S3_RATIO: Final = 0.4  # S3 of the tester to that of the controller: 2 s of 5 s, ISO 14229-2
_NUMBER: Final = "number"
_TEXT: Final = "text"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Parameter:
    """One communication parameter."""

    name: str
    group: str  # PARAM-CLASS
    usage: str = "ECU-COMM"
    default: str = "0"
    is_text: bool = False

    def element(self) -> Element:
        attributes = {"PARAM-CLASS": self.group, "CPTYPE": "STANDARD", "CPUSAGE": self.usage}
        made = named("COMPARAM", "COMPARAM", self.name, **attributes)
        made.append(node("PHYSICAL-DEFAULT-VALUE", self.default))
        made.append(reference("DATA-OBJECT-PROP-REF", "DOP", _TEXT if self.is_text else _NUMBER))
        return made


_IDENTIFIERS: Final = tuple(
    _Parameter(name=f"CP_{name}", group="UNIQUE_ID", is_text=name.endswith(("Format", "ShortName")))
    for name in (
        "CanPhysReqFormat",
        "CanPhysReqId",
        "CanPhysReqExtAddr",
        "CanRespUSDTFormat",
        "CanRespUSDTId",
        "CanRespUSDTExtAddr",
        "CanRespUUDTFormat",
        "CanRespUUDTId",
        "CanRespUUDTExtAddr",
        "ECULayerShortName",
    )
)
_TABLE: Final = "CP_UniqueRespIdTable"
_TRANSPORT: Final = (
    _Parameter(name="CP_CanFuncReqFormat", group="COM", is_text=True),
    _Parameter(name="CP_CanFuncReqId", group="COM", default="2015"),
    _Parameter(name="CP_CanFuncReqExtAddr", group="COM"),
    _Parameter(name="CP_CanFillerByteHandling", group="COM"),
    _Parameter(name="CP_CanFillerByte", group="COM"),
    _Parameter(name="CP_BlockSize", group="COM"),
    _Parameter(name="CP_StMin", group="COM"),
)
_APPLICATION: Final = (
    _Parameter(name="CP_P2Max", group="TIMING", default="50000"),
    _Parameter(name="CP_P2Star", group="TIMING", default="5000000"),
    _Parameter(name="CP_TesterPresentTime", group="TESTER_PRESENT", usage="APPLICATION", default="2000000"),
)


def specification() -> Element:
    """Return the COMPARAM-SPEC."""
    stack = named("PROT-STACK", "STACK", SPECIFICATION)
    references = (_subset_reference(name) for name in (TRANSPORT, APPLICATION))
    stack.append(node("PDU-PROTOCOL-TYPE", SPECIFICATION))
    stack.append(node("PHYSICAL-LINK-TYPE", PHYSICAL_LINK))
    stack.append(node("COMPARAM-SUBSET-REFS", *references))
    return node("COMPARAM-SPEC", {"ID": f"SPEC.{SPECIFICATION}"}, *title(SPECIFICATION), node("PROT-STACKS", stack))


def subsets() -> dict[str, Element]:
    """Return the COMPARAM-SUBSETs by name."""
    table = {"PARAM-CLASS": "UNIQUE_ID", "CPTYPE": "STANDARD", "CPUSAGE": "ECU-COMM", "ALLOW-MULTIPLE-VALUES": "true"}
    identifiers = named("COMPLEX-COMPARAM", "COMPARAM", _TABLE, **table)
    identifiers.extend(entry.element() for entry in _IDENTIFIERS)
    return {
        TRANSPORT: _subset(TRANSPORT, "TRANSPORT", _TRANSPORT, identifiers),
        APPLICATION: _subset(APPLICATION, "APPL", _APPLICATION, None),
    }


def communication_values(table: DiagnosticTable, protocol: str) -> list[Element]:
    """Return the COMPARAM-REFs of a controller."""
    transport, timing = table.transport, table.timing
    own, everybody = _format(table, table.addressing.request_id), _format(table, table.addressing.functional_id)
    simple = {
        "CP_CanFuncReqFormat": everybody,
        "CP_CanFuncReqId": str(table.addressing.functional_id),
        "CP_CanFuncReqExtAddr": str(transport.all_address if transport.own_address is not None else 0),
        "CP_CanFillerByteHandling": str(int(transport.padding is not None)),
        "CP_CanFillerByte": str(transport.padding or 0),
        "CP_BlockSize": str(transport.block_size),
        "CP_StMin": str(_separation_us(transport.separation_time)),
    }
    times = {
        "CP_P2Max": _microseconds(timing.p2_s),
        "CP_P2Star": _microseconds(timing.p2_star_s),
        "CP_TesterPresentTime": _microseconds(_S3_RATIO * timing.s3_s),
    }
    return [
        *(_value(TRANSPORT, name, protocol, node("SIMPLE-VALUE", text)) for name, text in simple.items()),
        _value(TRANSPORT, _TABLE, protocol, _identifiers(table, own)),
        *(_value(APPLICATION, name, protocol, node("SIMPLE-VALUE", text)) for name, text in times.items()),
    ]


def _subset(name: str, category: str, parameters: tuple[_Parameter, ...], complex_one: Element | None) -> Element:
    made = node("COMPARAM-SUBSET", {"ID": f"SUBSET.{name}", "CATEGORY": category}, *title(name))
    made.append(node("COMPARAMS", *(entry.element() for entry in parameters)))
    if complex_one is not None:
        made.append(node("COMPLEX-COMPARAMS", complex_one))
    made.append(
        node("DATA-OBJECT-PROPS", _property(_NUMBER, "A_UINT32", 32), _property(_TEXT, "A_UNICODE2STRING", 1024))
    )
    return made


def _property(name: str, data_type: str, bits: int) -> Element:
    coded = {"BASE-DATA-TYPE": data_type, "xsi:type": "STANDARD-LENGTH-TYPE"}
    made = named("DATA-OBJECT-PROP", "DOP", name)
    made.append(node("COMPU-METHOD", node("CATEGORY", "IDENTICAL")))
    made.append(node("DIAG-CODED-TYPE", coded, node("BIT-LENGTH", str(bits))))
    made.append(node("PHYSICAL-TYPE", {"BASE-DATA-TYPE": data_type}))
    return made


def _subset_reference(name: str) -> Element:
    return node("COMPARAM-SUBSET-REF", {"ID-REF": f"SUBSET.{name}", "DOCREF": name, "DOCTYPE": "COMPARAM-SUBSET"})


def _value(subset: str, name: str, protocol: str, content: Element) -> Element:
    attributes = {"ID-REF": f"COMPARAM.{name}", "DOCREF": subset, "DOCTYPE": "COMPARAM-SUBSET"}
    return node("COMPARAM-REF", attributes, content, node("PROTOCOL-SNREF", {"SHORT-NAME": protocol}))


def _identifiers(table: DiagnosticTable, way: str) -> Element:
    ids, transport = table.addressing, table.transport
    is_extended, periodic = transport.own_address is not None, table.periodic
    values = (
        way,
        str(ids.request_id),
        str(transport.own_address or 0),
        way,
        str(ids.response_id),
        str(transport.tester_address if is_extended else 0),
        "" if periodic is None else f"normal unsegmented {_id_bits(periodic.response_id)}-bit receive",
        str(0 if periodic is None else periodic.response_id),
        str(transport.tester_address if is_extended and periodic is not None else 0),
        table.name,
    )
    return node("COMPLEX-VALUE", *(node("SIMPLE-VALUE", text) for text in values))


def _format(table: DiagnosticTable, can_id: int) -> str:
    addressing = "normal" if table.transport.own_address is None else "extended"
    return f"{addressing} segmented {_id_bits(can_id)}-bit transmit with FC"


def _id_bits(can_id: int) -> int:
    return 29 if can_id > LARGEST_STANDARD_ID else 11


def _separation_us(coded: int) -> int:
    """Return STmin as ISO 15765-2 codes it: 0 to 7F milliseconds, F1 to F9 hundreds of microseconds."""
    if coded <= 0x7F:
        return coded * 1000
    return (coded - 0xF0) * 100 if 0xF1 <= coded <= 0xF9 else 0x7F * 1000


def _microseconds(time_s: float) -> str:
    return str(round(time_s * _US_PER_S))
