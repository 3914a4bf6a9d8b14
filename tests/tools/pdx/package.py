"""Writes a controller as a PDX package (ODX 2.2, ISO 22901-1): ``python -m tests.tools.pdx.package [TABLE PACKAGE]``.

Without words it is the package of the emulated controller, which ships. The same table gives the same bytes.
"""

import io
import re
import shutil
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Any, Final

import odxtools
from odxtools.addressing import Addressing
from odxtools.admindata import AdminData
from odxtools.comparaminstance import ComparamInstance
from odxtools.complexcomparam import ComplexValue
from odxtools.database import Database
from odxtools.diaglayercontainer import DiagLayerContainer
from odxtools.diaglayers.basevariant import BaseVariant
from odxtools.diaglayers.basevariantraw import BaseVariantRaw
from odxtools.diaglayers.diaglayertype import DiagLayerType
from odxtools.diaglayers.protocol import Protocol
from odxtools.diaglayers.protocolraw import ProtocolRaw
from odxtools.diagservice import DiagService
from odxtools.docrevision import DocRevision
from odxtools.nameditemlist import NamedItemList
from odxtools.odxlink import DocType
from odxtools.parentref import ParentRef
from odxtools.posresponsesuppressible import PosResponseSuppressible
from odxtools.preconditionstateref import PreConditionStateRef
from odxtools.request import Request
from odxtools.response import Response, ResponseType
from odxtools.state import State
from odxtools.statechart import StateChart
from odxtools.statetransition import StateTransition
from odxtools.statetransitionref import StateTransitionRef
from odxtools.writepdxfile import write_pdx_file

from tests.tools.pdx.elements import (
    Dictionary,
    Document,
    Names,
    Part,
    constant,
    placed,
    short_name,
    value,
    worded,
    xml_text,
)
from tests.tools.pdx.services import ObdServices, OdxService, UdsServices
from workshop.controller.descriptions import AccessRule
from workshop.controller.iso14229 import DEFAULT_SESSION, NEGATIVE, POSITIVE, SUPPRESS, Nrc
from workshop.controller.table import DiagnosticTable, load_table, shipped_table

FILE: Final = Path(__file__).parents[3] / "workshop/src/workshop/controller/tcu.pdx"
_STACK: Final = "ISO_15765_3_on_ISO_15765_2"
_TRANSPORT: Final = "ISO_15765_2"
_APPLICATION: Final = "ISO_15765_3"
_IP_STACK: Final = "ISO_14229_5_on_ISO_13400_2"
_IP_TRANSPORT: Final = "ISO_13400_2"
_IP_APPLICATION: Final = "ISO_14229_5"
_BASE: Final = (  # beside this file; names are those that Eclipse OpenSOVD's classic diagnostic adapter has
    f"{_STACK}.odx-c", f"{_TRANSPORT}.odx-cs", f"{_APPLICATION}.odx-cs",
    f"{_IP_STACK}.odx-c", f"{_IP_TRANSPORT}.odx-cs", f"{_IP_APPLICATION}.odx-cs",
)  # fmt: skip
_ON_CAN, _ON_IP, _OBD_ON_CAN = "UDS_CAN", "UDS_Ethernet_DoIP", "OBD_on_CAN"  # likewise the first two
_SOFTWARE: Final = 0xF189  # data whose text is the revision of the package
_LARGEST_STANDARD_ID: Final = 0x7FF
_US_PER_S: Final = 1e6
_S3_RATIO: Final = 0.4  # S3 of the tester to that of the controller: 2 s of 5 s, ISO 14229-2


def communication_values(table: DiagnosticTable, protocol: str) -> list[ComparamInstance]:
    """Return what a tester must know to speak a protocol with the controller."""
    values = _over_ip(table) if protocol == _ON_IP else _on_can(table)
    return [
        ComparamInstance(value=entry, protocol_snref=protocol, spec_ref=subset.ref("COMPARAM", name))
        for subset_name, entries in values.items()
        for subset in [Document(subset_name, DocType.COMPARAM_SUBSET)]
        for name, entry in entries.items()
    ]


def _over_ip(table: DiagnosticTable) -> dict[str, dict[str, str | ComplexValue]]:
    doip, timing = table.doip, table.timing
    return {
        _IP_TRANSPORT: {
            "CP_DoIPLogicalGatewayAddress": str(doip.logical_address),
            "CP_DoIPLogicalFunctionalAddress": str(doip.functional_address),
            "CP_UniqueRespIdTable": [str(doip.logical_address), "0", xml_text(table.name)],
        },
        _IP_APPLICATION: {
            "CP_P6Max": str(round(timing.p2_s * _US_PER_S)),
            "CP_P6Star": str(round(timing.p2_star_s * _US_PER_S)),
            "CP_TesterPresentTime": str(round(_S3_RATIO * timing.s3_s * _US_PER_S)),
        },
    }


def _on_can(table: DiagnosticTable) -> dict[str, dict[str, str | ComplexValue]]:
    transport, timing = table.transport, table.timing
    return {
        _TRANSPORT: {
            "CP_CanFuncReqFormat": _format(table, table.addressing.functional_id),
            "CP_CanFuncReqId": str(table.addressing.functional_id),
            "CP_CanFuncReqExtAddr": str(transport.all_address if transport.own_address is not None else 0),
            "CP_CanFillerByteHandling": str(int(transport.padding is not None)),
            "CP_CanFillerByte": str(transport.padding or 0),
            "CP_BlockSize": str(transport.block_size),
            "CP_StMin": str(_separation_us(transport.separation_time)),
            "CP_UniqueRespIdTable": _identifiers(table),
        },
        _APPLICATION: {
            "CP_P2Max": str(round(timing.p2_s * _US_PER_S)),
            "CP_P2Star": str(round(timing.p2_star_s * _US_PER_S)),
            "CP_TesterPresentTime": str(round(_S3_RATIO * timing.s3_s * _US_PER_S)),
        },
    }


def _identifiers(table: DiagnosticTable) -> ComplexValue:
    """Return the values of the table of identifiers: format, identifier and address three times, and a name."""
    ids, transport = table.addressing, table.transport
    tester = str(transport.tester_address if transport.own_address is not None else 0)
    way = _format(table, ids.request_id)
    unsegmented = ["", "0", "0"]
    asked, answered = [way, str(ids.request_id), str(transport.own_address or 0)], [way, str(ids.response_id), tester]
    return [*asked, *answered, *unsegmented, xml_text(table.name)]


def _format(table: DiagnosticTable, can_id: int) -> str:
    addressing = "normal" if table.transport.own_address is None else "extended"
    return f"{addressing} segmented {_id_bits(can_id)}-bit transmit with FC"


def _id_bits(can_id: int) -> int:
    return 29 if can_id > _LARGEST_STANDARD_ID else 11


def _separation_us(coded_time: int) -> int:
    """Return STmin as ISO 15765-2 codes it: 0 to 7F milliseconds, F1 to F9 hundreds of microseconds."""
    is_short = 0xF1 <= coded_time <= 0xF9
    return (coded_time - 0xF0) * 100 if is_short else min(coded_time, 0x7F) * 1000


_LOCKED: Final = 0  # the security level of a controller that is not unlocked
_REVISED: Final = "2026-01-01T00:00:00"
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
    database.diag_layer_containers.append(_container(table, database.short_name, _ON_CAN))
    if table.obd is not None:
        name = f"{database.short_name}_OBD"
        database.diag_layer_containers.append(_container(table, name, _OBD_ON_CAN))
    ip = Document(_ON_IP, DocType.CONTAINER)
    spoken = NamedItemList([_protocol(ip, _ON_IP, _IP_STACK)])
    database.diag_layer_containers.append(DiagLayerContainer(**ip.named("CONTAINER", _ON_IP), protocols=spoken))
    for name in _BASE:
        database.add_odx_file(Path(__file__).with_name(name))
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
    software = table.data.get(_SOFTWARE)
    label = (software.initial if software is not None else None) or "0"
    return DiagLayerContainer(
        **layer.dictionary.named("CONTAINER", name, table.name),
        admin_data=AdminData(doc_revisions=[DocRevision(revision_label=xml_text(label), date=_REVISED)]),
        protocols=NamedItemList([_protocol(layer.dictionary, protocol, _STACK)]),
        base_variants=NamedItemList([BaseVariant(diag_layer_raw=layer.variant(protocol))]),
    )


def _protocol(document: Document, name: str, stack: str) -> Protocol:
    spoken = ProtocolRaw(
        **document.named("LAYER", name),
        variant_type=DiagLayerType.PROTOCOL,
        comparam_spec_ref=Document(stack, DocType.COMPARAM_SPEC).ref("SPEC", stack),
        prot_stack_snref=stack,
    )
    return Protocol(diag_layer_raw=spoken)


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
        is_obd = protocol == _OBD_ON_CAN
        offered = ObdServices(table, table.obd, dictionary) if is_obd and table.obd else UdsServices(table, dictionary)
        names = Names()
        services = {names.new(service.name): service for service in offered}
        numbers = sorted({service.number for service in services.values()})
        codes = {int(nrc): nrc.name.lower().replace("_", " ") for nrc in Nrc}
        code = value("response_code", dictionary.simple("negative response code", worded(codes)), 1)
        named = dictionary.named
        spoken: dict[str, Document] = {protocol: dictionary}
        spoken |= {} if is_obd else {_ON_IP: Document(_ON_IP, DocType.CONTAINER)}
        requests = (
            Request(**named("REQUEST", name), parameters=placed((_id(entry.number), *entry.request)))
            for name, entry in services.items()
        )
        positive = (
            _response(named("RESPONSE", given), ResponseType.POSITIVE, _id(entry.number + POSITIVE), *parts)
            for name, entry in services.items()
            for given, parts in zip(_response_names(name, entry), entry.responses, strict=True)
        )
        negative = (
            _response(
                named("RESPONSE", _negative(number)), ResponseType.NEGATIVE, _id(NEGATIVE),
                constant("request_service", number, semantic="SERVICEIDRQ"), code,
            )
            for number in numbers
        )  # fmt: skip
        return BaseVariantRaw(
            **named("LAYER", self._name, table.name), variant_type=DiagLayerType.BASE_VARIANT,
            diag_comms_raw=[self._comm(name, service, has_states=not is_obd) for name, service in services.items()],
            requests=NamedItemList(requests), positive_responses=NamedItemList(positive),
            negative_responses=NamedItemList(negative),
            diag_data_dictionary_spec=dictionary.spec(),
            state_charts=NamedItemList([] if is_obd else self._charts()),
            comparam_refs=[value for name in spoken for value in communication_values(table, name)],
            parent_refs=[ParentRef(layer_ref=document.ref("LAYER", name)) for name, document in spoken.items()],
        )  # fmt: skip

    def _comm(self, name: str, service: OdxService, *, has_states: bool) -> DiagService:
        ref, access = self.dictionary.ref, service.access
        conditions = (f"{entry} (else {self._table.conditions[entry].nrc:02X})" for entry in access.conditions)
        text = f"Needs of the vehicle: {', '.join(conditions)}." if access.conditions else ""
        suppressible = PosResponseSuppressible(bit_mask=SUPPRESS, coded_const_snref="sub_function")
        states, changes = (self._needed(access), self._changes(service)) if has_states else ([], [])
        return DiagService(
            **self.dictionary.named("SERVICE", name, service.name, text),  # for conditions ODX has no element
            semantic=service.semantic, addressing_raw=Addressing.FUNCTIONAL_OR_PHYSICAL,
            pre_condition_state_refs=[PreConditionStateRef(**vars(ref("STATE", state))) for state in states],
            state_transition_refs=[StateTransitionRef(**vars(ref("TRANSITION", _step(*step)))) for step in changes],
            request_ref=ref("REQUEST", name), neg_response_refs=[ref("RESPONSE", _negative(service.number))],
            pos_response_refs=[ref("RESPONSE", given) for given in _response_names(name, service)],
            pos_response_suppressible=suppressible if service.has_sub_function else None,
        )  # fmt: skip

    def _needed(self, access: AccessRule) -> list[str]:
        """Return the states of which a service needs one each."""
        is_everywhere = set(access.sessions) == set(self._sessions) and not access.levels
        sessions = () if is_everywhere else access.sessions
        return [*(self._sessions[number] for number in sessions), *(self._levels[number] for number in access.levels)]

    def _changes(self, service: OdxService) -> list[tuple[str, str]]:
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
        made = [
            StateTransition(**named("TRANSITION", _step(*change)), source_snref=change[0], target_snref=change[1])
            for change in changes
        ]
        listed = NamedItemList(State(**named("STATE", state)) for state in states)
        return StateChart(
            **named("CHART", name),
            semantic=name.upper(),
            state_transitions=made,
            start_state_snref=start,
            states=listed,
        )


def _response(named: dict[str, Any], kind: ResponseType, *parts: Part) -> Response:
    return Response(**named, response_type=kind, parameters=placed(parts))


def _id(number: int) -> Part:
    return constant("service", number, semantic="SERVICE-ID")


def _step(origin: str, target: str) -> str:
    return f"{origin}_to_{target}"


def _negative(number: int) -> str:
    return f"negative_response_{number:02X}"


def _response_names(name: str, service: OdxService) -> list[str]:
    places = range(2, len(service.responses) + 1)
    return [f"{name}_response", *(f"{name}_response_{place}" for place in places)]


if __name__ == "__main__":
    table, package = (load_table(Path(sys.argv[1])), Path(sys.argv[2])) if sys.argv[1:] else (shipped_table(), FILE)
    package.write_bytes(pdx_package(table))
