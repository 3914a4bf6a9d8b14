"""How a tool reaches the controller: communication parameters as ISO 22900-2 names them, and their values."""

from dataclasses import replace
from typing import Final

from odxtools.comparam import Comparam
from odxtools.comparaminstance import ComparamInstance
from odxtools.comparamspec import ComparamSpec
from odxtools.comparamsubset import ComparamSubset
from odxtools.complexcomparam import ComplexComparam
from odxtools.dataobjectproperty import DataObjectProperty
from odxtools.nameditemlist import NamedItemList
from odxtools.odxlink import DocType
from odxtools.physicaltype import PhysicalType
from odxtools.protstack import ProtStack
from odxtools.standardizationlevel import StandardizationLevel
from odxtools.usage import Usage

from ecu_emulator.diagnostics.pdx.elements import TEXT, Document, coded, unsigned, xml_text
from ecu_emulator.diagnostics.table import DiagnosticTable

STACK: Final = "ISO_15765_3_on_ISO_15765_2"
SPECIFICATION: Final = Document(STACK, DocType.COMPARAM_SPEC)
_TRANSPORT: Final = "ISO_15765_2"
_APPLICATION: Final = "ISO_15765_3"
_IDENTIFIERS: Final = "CP_UniqueRespIdTable"
_LARGEST_STANDARD_ID: Final = 0x7FF
_US_PER_S: Final = 1e6
_S3_RATIO: Final = 0.4  # S3 of the tester to that of the controller: 2 s of 5 s, ISO 14229-2
_DEFAULTS: Final = {  # of each parameter: its class, and its value where a controller says nothing
    _TRANSPORT: {
        "CP_CanFuncReqFormat": ("COM", "0"),
        "CP_CanFuncReqId": ("COM", "2015"),
        "CP_CanFuncReqExtAddr": ("COM", "0"),
        "CP_CanFillerByteHandling": ("COM", "0"),
        "CP_CanFillerByte": ("COM", "0"),
        "CP_BlockSize": ("COM", "0"),
        "CP_StMin": ("COM", "0"),
    },
    _APPLICATION: {
        "CP_P2Max": ("TIMING", "50000"),
        "CP_P2Star": ("TIMING", "5000000"),
        "CP_TesterPresentTime": ("TESTER_PRESENT", "2000000"),
    },
}


def specification() -> ComparamSpec:
    """Return the stack of protocols."""
    stack = ProtStack(
        **SPECIFICATION.named("STACK", STACK),
        pdu_protocol_type=STACK,
        physical_link_type="ISO_11898_2_DWCAN",
        comparam_subset_refs=[_subset(name).ref("SUBSET", name) for name in _DEFAULTS],
    )
    return ComparamSpec(**SPECIFICATION.named("SPEC", STACK), prot_stacks=NamedItemList([stack]))


def subsets(table: DiagnosticTable) -> list[ComparamSubset]:
    """Return the parameters of each protocol of the stack."""
    categories = {_TRANSPORT: "TRANSPORT", _APPLICATION: "APPL"}
    return [
        ComparamSubset(
            **_subset(name).named("SUBSET", name),
            category=categories[name],
            comparams=NamedItemList(_parameter(name, *entry) for entry in parameters.items()),
            complex_comparams=NamedItemList([_identifier_table(table)] if name == _TRANSPORT else []),
            data_object_props=NamedItemList(_properties(_subset(name))),
        )
        for name, parameters in _DEFAULTS.items()
    ]


def communication_values(table: DiagnosticTable, protocol: str) -> list[ComparamInstance]:
    """Return the values of a controller."""
    transport, timing = table.transport, table.timing
    values: dict[str, dict[str, str | list[str]]] = {
        _TRANSPORT: {
            "CP_CanFuncReqFormat": _format(table, table.addressing.functional_id),
            "CP_CanFuncReqId": str(table.addressing.functional_id),
            "CP_CanFuncReqExtAddr": str(transport.all_address if transport.own_address is not None else 0),
            "CP_CanFillerByteHandling": str(int(transport.padding is not None)),
            "CP_CanFillerByte": str(transport.padding or 0),
            "CP_BlockSize": str(transport.block_size),
            "CP_StMin": str(_separation_us(transport.separation_time)),
            _IDENTIFIERS: list(_identifiers(table).values()),
        },
        _APPLICATION: {
            "CP_P2Max": _microseconds(timing.p2_s),
            "CP_P2Star": _microseconds(timing.p2_star_s),
            "CP_TesterPresentTime": _microseconds(_S3_RATIO * timing.s3_s),
        },
    }
    return [
        ComparamInstance(value=list(value) if isinstance(value, list) else value, protocol_snref=protocol, spec_ref=ref)
        for subset, entries in values.items()
        for name, value in entries.items()
        for ref in [_subset(subset).ref("COMPARAM", name)]
    ]


def _subset(name: str) -> Document:
    return Document(name, DocType.COMPARAM_SUBSET)


def _parameter(subset: str, name: str, entry: tuple[str, str]) -> Comparam:
    is_text = name.endswith(("Format", "ShortName"))
    document = _subset(subset)
    return Comparam(
        **document.named("COMPARAM", name),
        param_class=entry[0],
        cptype=StandardizationLevel.STANDARD,
        cpusage=Usage.APPLICATION if entry[0] == "TESTER_PRESENT" else Usage.ECU_COMM,
        physical_default_value_raw=entry[1],
        dop_ref=document.ref("DOP", "text" if is_text else "number"),
    )


def _identifier_table(table: DiagnosticTable) -> ComplexComparam:
    return ComplexComparam(
        **_subset(_TRANSPORT).named("COMPARAM", _IDENTIFIERS),
        param_class="UNIQUE_ID",
        cptype=StandardizationLevel.STANDARD,
        cpusage=Usage.ECU_COMM,
        allow_multiple_values_raw=True,
        subparams=NamedItemList(_parameter(_TRANSPORT, name, ("UNIQUE_ID", "0")) for name in _identifiers(table)),
    )


def _identifiers(table: DiagnosticTable) -> dict[str, str]:
    """Return the columns of the table of identifiers, and their values."""
    ids, transport, periodic = table.addressing, table.transport, table.periodic
    is_extended, way = transport.own_address is not None, _format(table, table.addressing.request_id)
    unsegmented = "" if periodic is None else f"normal unsegmented {_id_bits(periodic.response_id)}-bit receive"
    return {
        "CP_CanPhysReqFormat": way,
        "CP_CanPhysReqId": str(ids.request_id),
        "CP_CanPhysReqExtAddr": str(transport.own_address or 0),
        "CP_CanRespUSDTFormat": way,
        "CP_CanRespUSDTId": str(ids.response_id),
        "CP_CanRespUSDTExtAddr": str(transport.tester_address if is_extended else 0),
        "CP_CanRespUUDTFormat": unsegmented,
        "CP_CanRespUUDTId": str(0 if periodic is None else periodic.response_id),
        "CP_CanRespUUDTExtAddr": str(transport.tester_address if is_extended and periodic is not None else 0),
        "CP_ECULayerShortName": xml_text(table.name),
    }


def _properties(document: Document) -> list[DataObjectProperty]:
    text = replace(unsigned(4), diag_coded_type=coded(TEXT, 1024), physical_type=PhysicalType(base_data_type=TEXT))
    text.compu_method = replace(text.compu_method, internal_type=TEXT, physical_type=TEXT)
    return [replace(made, **document.named("DOP", name)) for name, made in (("number", unsigned(4)), ("text", text))]


def _format(table: DiagnosticTable, can_id: int) -> str:
    addressing = "normal" if table.transport.own_address is None else "extended"
    return f"{addressing} segmented {_id_bits(can_id)}-bit transmit with FC"


def _id_bits(can_id: int) -> int:
    return 29 if can_id > _LARGEST_STANDARD_ID else 11


def _separation_us(coded_time: int) -> int:
    """Return STmin as ISO 15765-2 codes it: 0 to 7F milliseconds, F1 to F9 hundreds of microseconds."""
    if coded_time <= 0x7F:
        return coded_time * 1000
    return (coded_time - 0xF0) * 100 if 0xF1 <= coded_time <= 0xF9 else 0x7F * 1000


def _microseconds(time_s: float) -> str:
    return str(round(time_s * _US_PER_S))
