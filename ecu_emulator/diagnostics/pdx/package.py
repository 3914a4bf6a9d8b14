"""A controller as a PDX package (ODX 2.2, ISO 22901-1), written by odxtools: the same bytes for the same table."""

import io
import re
import shutil
import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Final

import odxtools
from odxtools.addressing import Addressing
from odxtools.comparam import Comparam
from odxtools.comparaminstance import ComparamInstance
from odxtools.comparamspec import ComparamSpec
from odxtools.comparamsubset import ComparamSubset
from odxtools.complexcomparam import ComplexComparam
from odxtools.database import Database
from odxtools.dataobjectproperty import DataObjectProperty
from odxtools.diaglayercontainer import DiagLayerContainer
from odxtools.diaglayers.basevariant import BaseVariant
from odxtools.diaglayers.basevariantraw import BaseVariantRaw
from odxtools.diaglayers.diaglayertype import DiagLayerType
from odxtools.diaglayers.protocol import Protocol
from odxtools.diaglayers.protocolraw import ProtocolRaw
from odxtools.diagservice import DiagService
from odxtools.nameditemlist import NamedItemList
from odxtools.odxlink import DocType
from odxtools.parentref import ParentRef
from odxtools.physicaltype import PhysicalType
from odxtools.posresponsesuppressible import PosResponseSuppressible
from odxtools.preconditionstateref import PreConditionStateRef
from odxtools.protstack import ProtStack
from odxtools.request import Request
from odxtools.response import Response, ResponseType
from odxtools.standardizationlevel import StandardizationLevel
from odxtools.state import State
from odxtools.statechart import StateChart
from odxtools.statetransition import StateTransition
from odxtools.statetransitionref import StateTransitionRef
from odxtools.usage import Usage
from odxtools.writepdxfile import write_pdx_file

from ecu_emulator.diagnostics.descriptions import Access, Profile
from ecu_emulator.diagnostics.iso14229 import DEFAULT_SESSION, NEGATIVE, POSITIVE, SUPPRESS, Nrc
from ecu_emulator.diagnostics.pdx.elements import (
    TEXT,
    Dictionary,
    Document,
    Names,
    Part,
    coded,
    constant,
    placed,
    short_name,
    unsigned,
    value,
    worded,
    xml_text,
)
from ecu_emulator.diagnostics.pdx.services import ObdServices, Service, UdsServices
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


_LOCKED: Final = 0  # the security level of a controller that is not unlocked
_ZIP_DATE: Final = (2026, 1, 1, 0, 0, 0)  # of every file: a package says what the table says, not when it was asked
_DATE: Final = (re.compile(rb'CREATION-DATE="[^"]*"'), b'CREATION-DATE="2026-01-01T00:00:00"')
_UNIX: Final = 3
# The templates of odxtools 11.7 leave out what can be suppressed, print the limits of what is on the wire for those of
# the value, and do not escape: each by file, what is wrong and what is right; of a version that mends it, nothing.
_SUPPRESSIBLE: Final = (
    "  {%- if service.pos_response_suppressible is not none %}\n"
    "  {{ printPosResponseSuppressible(service.pos_response_suppressible) | indent(2) }}\n  {%- endif %}\n"
)
_MENDED: Final = (
    ("printService", "  {%- endif%}\n</DIAG-SERVICE>", f"  {{%- endif%}}\n{_SUPPRESSIBLE}</DIAG-SERVICE>"),
    ("printDOP", "printInternalConstr(dop.internal_constr, True)", "printInternalConstr(dop.physical_constr, True)"),
    ("printUnitSpec", "{{ unit.display_name }}", "{{ unit.display_name | e }}"),
    ("printComparam", "<SIMPLE-VALUE>{{val}}<", "<SIMPLE-VALUE>{{val | e}}<"),
)


def pdx_package(table: DiagnosticTable) -> bytes:
    """Return the bytes of a PDX file that describes what a table describes."""
    database = Database(use_weakrefs=False)
    database.short_name = short_name(table.name)
    database.diag_layer_containers.append(_container(table, database.short_name, "UDS_on_CAN"))
    if table.obd is not None and table.has_obd(Profile.CLASSIC):
        name = f"{database.short_name}_OBD"
        database.diag_layer_containers.append(_container(table, name, "OBD_on_CAN"))
    database.comparam_specs.append(specification())
    for subset in subsets(table):
        database.comparam_subsets.append(subset)
    database.refresh()
    with tempfile.TemporaryDirectory() as folder:
        templates, package = Path(folder, "templates"), Path(folder, "package.pdx")
        shutil.copytree(Path(odxtools.__file__).with_name("templates"), templates)
        for name, wrong, right in _MENDED:
            template = templates / "macros" / f"{name}.xml.jinja2"
            template.write_text(template.read_text("utf-8").replace(wrong, right), "utf-8")
        write_pdx_file(str(package), database, str(templates))
        return _undated(package)


def _undated(package: Path) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(package) as written, zipfile.ZipFile(content, "w") as archive:
        for name in written.namelist():
            entry = zipfile.ZipInfo(name, _ZIP_DATE)
            entry.create_system, entry.external_attr = _UNIX, 0o644 << 16
            archive.writestr(entry, _DATE[0].sub(_DATE[1], written.read(name)), zipfile.ZIP_DEFLATED, 9)
    return content.getvalue()


def _container(table: DiagnosticTable, name: str, protocol: str) -> DiagLayerContainer:
    """Return a controller as a base variant with its services by one protocol, and the protocol."""
    layer = _Layer(table, name)
    spoken = ProtocolRaw(
        **layer.dictionary.named("LAYER", protocol),
        variant_type=DiagLayerType.PROTOCOL,
        comparam_spec_ref=SPECIFICATION.ref("SPEC", STACK),
        prot_stack_snref=STACK,
    )
    return DiagLayerContainer(
        **layer.dictionary.named("CONTAINER", name, table.name),
        protocols=NamedItemList([Protocol(diag_layer_raw=spoken)]),
        base_variants=NamedItemList([BaseVariant(diag_layer_raw=layer.variant(protocol))]),
    )


class _Layer:
    """A base variant in the making: its dictionary, its state charts, and its services."""

    def __init__(self, table: DiagnosticTable, name: str) -> None:
        self.dictionary = Dictionary(name)
        self._table, self._name = table, name
        names = Names()
        self._sessions = {number: names.new(f"session {entry.name}") for number, entry in table.sessions.items()}
        self._levels = {_LOCKED: names.new("locked")}
        self._levels |= {number: names.new(f"unlocked {entry.name}") for number, entry in table.levels.items()}

    def variant(self, protocol: str) -> BaseVariantRaw:
        """Return the layer, with all that the controller answers by a protocol."""
        table, dictionary = self._table, self.dictionary
        is_obd = protocol.startswith("OBD")
        offered = ObdServices(table, table.obd, dictionary) if is_obd and table.obd else UdsServices(table, dictionary)
        names = Names()
        services = {names.new(service.name): service for service in offered}
        numbers = sorted({service.number for service in services.values()})
        codes = {int(nrc): nrc.name.lower().replace("_", " ") for nrc in Nrc}
        code = value("response_code", dictionary.simple("negative response code", worded(codes)), 1)
        return BaseVariantRaw(
            **dictionary.named("LAYER", self._name, table.name),
            variant_type=DiagLayerType.BASE_VARIANT,
            diag_comms_raw=[self._comm(name, service, has_states=not is_obd) for name, service in services.items()],
            requests=NamedItemList(
                Request(**dictionary.named("REQUEST", name), parameters=placed((_id(entry.number), *entry.request)))
                for name, entry in services.items()
            ),
            positive_responses=NamedItemList(
                Response(
                    **dictionary.named("RESPONSE", given),
                    response_type=ResponseType.POSITIVE,
                    parameters=placed((_id(entry.number + POSITIVE), *parts)),
                )
                for name, entry in services.items()
                for given, parts in zip(_response_names(name, entry), entry.responses, strict=True)
            ),
            negative_responses=NamedItemList(
                Response(
                    **dictionary.named("RESPONSE", _negative(number)),
                    response_type=ResponseType.NEGATIVE,
                    parameters=placed(
                        (_id(NEGATIVE), constant("request_service", number, semantic="SERVICEIDRQ"), code)
                    ),
                )
                for number in numbers
            ),
            diag_data_dictionary_spec=dictionary.spec(),
            state_charts=NamedItemList([] if is_obd else self._charts()),
            comparam_refs=communication_values(table, protocol),
            parent_refs=[ParentRef(layer_ref=dictionary.ref("LAYER", protocol))],
        )

    def _comm(self, name: str, service: Service, *, has_states: bool) -> DiagService:
        ref, access = self.dictionary.ref, service.access
        conditions = (f"{entry} (else {self._table.conditions[entry].nrc:02X})" for entry in access.conditions)
        text = f"Needs of the vehicle: {', '.join(conditions)}." if access.conditions else ""
        suppressible = PosResponseSuppressible(bit_mask=SUPPRESS, coded_const_snref="sub_function")
        return DiagService(
            **self.dictionary.named("SERVICE", name, service.name, text),  # for conditions ODX has no element
            semantic=service.semantic,
            addressing_raw=Addressing.FUNCTIONAL_OR_PHYSICAL,
            pre_condition_state_refs=[
                PreConditionStateRef(**vars(ref("STATE", state)))
                for state in (self._needed(access) if has_states else ())
            ],
            state_transition_refs=[
                StateTransitionRef(**vars(ref("TRANSITION", _step(*change))))
                for change in (self._changes(service) if has_states else ())
            ],
            request_ref=ref("REQUEST", name),
            pos_response_refs=[ref("RESPONSE", given) for given in _response_names(name, service)],
            neg_response_refs=[ref("RESPONSE", _negative(service.number))],
            pos_response_suppressible=suppressible if service.has_sub_function else None,
        )

    def _needed(self, access: Access) -> list[str]:
        """Return the states of which a service needs one each."""
        is_everywhere = set(access.sessions) == set(self._sessions) and not access.levels
        sessions = () if is_everywhere else access.sessions
        return [*(self._sessions[number] for number in sessions), *(self._levels[number] for number in access.levels)]

    def _changes(self, service: Service) -> list[tuple[str, str]]:
        changes = list[tuple[str, str]]()
        session = DEFAULT_SESSION if service.resets else service.enters
        if session is not None:
            changes += [(self._sessions[origin], self._sessions[session]) for origin in service.access.sessions]
            changes += [(name, self._levels[_LOCKED]) for name in self._levels.values()]
        if service.unlocks is not None:
            changes += [(name, self._levels[service.unlocks]) for name in self._levels.values()]
        return changes

    def _charts(self) -> list[StateChart]:
        entered = [
            (self._sessions[origin], self._sessions[target])
            for target, entry in self._table.sessions.items()
            for origin in self._table.sessions
            if origin in entry.from_sessions or target == DEFAULT_SESSION
        ]
        levels = list(self._levels.values())
        unlocked = [(origin, target) for target in levels for origin in levels]
        return [
            self._chart("Session", list(self._sessions.values()), entered, self._sessions[DEFAULT_SESSION]),
            self._chart("Security", levels, unlocked, self._levels[_LOCKED]),
        ]

    def _chart(self, name: str, states: list[str], changes: list[tuple[str, str]], start: str) -> StateChart:
        named = self.dictionary.named
        return StateChart(
            **named("CHART", name),
            semantic=name.upper(),
            state_transitions=[
                StateTransition(**named("TRANSITION", _step(*change)), source_snref=change[0], target_snref=change[1])
                for change in changes
            ],
            start_state_snref=start,
            states=NamedItemList(State(**named("STATE", state)) for state in states),
        )


def _id(number: int) -> Part:
    return constant("service", number, semantic="SERVICE-ID")


def _step(origin: str, target: str) -> str:
    return f"{origin}_to_{target}"


def _negative(number: int) -> str:
    return f"negative_response_{number:02X}"


def _response_names(name: str, service: Service) -> list[str]:
    places = range(2, len(service.responses) + 1)
    return [f"{name}_response", *(f"{name}_response_{place}" for place in places)]
