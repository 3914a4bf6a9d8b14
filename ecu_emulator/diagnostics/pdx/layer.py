"""The controller as a layer of ODX: a base variant with all its services, over the protocol that it speaks."""

from collections.abc import Callable, Iterable, Iterator
from typing import Final
from xml.etree.ElementTree import Element

from ecu_emulator.diagnostics.codes import Nrc
from ecu_emulator.diagnostics.codes import Service as Number
from ecu_emulator.diagnostics.descriptions import Access
from ecu_emulator.diagnostics.obd_descriptions import Profile
from ecu_emulator.diagnostics.pdx.coded_types import worded
from ecu_emulator.diagnostics.pdx.communication import SPECIFICATION, communication_values
from ecu_emulator.diagnostics.pdx.data_services import (
    DataNames,
    controlling_services,
    defining_services,
    periodic_services,
    reading_services,
    writing_services,
)
from ecu_emulator.diagnostics.pdx.dictionary import Dictionary
from ecu_emulator.diagnostics.pdx.elements import Names, listed, named, node, reference, short_name, title
from ecu_emulator.diagnostics.pdx.obd_services import emission_data_services, obd_services
from ecu_emulator.diagnostics.pdx.parameters import value
from ecu_emulator.diagnostics.pdx.routine_services import routine_services
from ecu_emulator.diagnostics.pdx.service import (
    Service,
    negative_element,
    request_element,
    response_elements,
    service_element,
)
from ecu_emulator.diagnostics.pdx.session_services import (
    communication_services,
    presence_services,
    reset_services,
    security_services,
    session_services,
    setting_services,
)
from ecu_emulator.diagnostics.pdx.states import States
from ecu_emulator.diagnostics.pdx.trouble_services import TroubleNames, clearing_services, trouble_services
from ecu_emulator.diagnostics.table import DiagnosticTable

PROTOCOL: Final = "UDS_on_CAN"
OBD_PROTOCOL: Final = "OBD_on_CAN"


def layer_container(table: DiagnosticTable) -> Element:
    """Return the DIAG-LAYER-CONTAINER of what UDS reaches."""
    dictionary, states = Dictionary(), States(table)
    services = list(services_of(table, dictionary))
    return _container(table, container_name(table), PROTOCOL, _variant(table, PROTOCOL, services, dictionary, states))


def obd_container(table: DiagnosticTable) -> Element | None:
    """Return the DIAG-LAYER-CONTAINER of the services 01 to 0A of OBD, none if they are not spoken."""
    if table.obd is None or not table.has_obd(Profile.CLASSIC):
        return None
    dictionary = Dictionary()
    services = list(obd_services(table, table.obd, dictionary))
    variant = _variant(table, OBD_PROTOCOL, services, dictionary, None)
    return _container(table, obd_container_name(table), OBD_PROTOCOL, variant)


def container_name(table: DiagnosticTable) -> str:
    """Return the name of the container, and so of its file."""
    return short_name(table.name)


def obd_container_name(table: DiagnosticTable) -> str:
    """Return the name of the container with OBD."""
    return f"{container_name(table)}_OBD"


def _container(table: DiagnosticTable, name: str, protocol: str, variant: Element) -> Element:
    made = node("DIAG-LAYER-CONTAINER", {"ID": f"CONTAINER.{name}"}, *title(name, table.name))
    made.append(node("PROTOCOLS", _protocol(protocol)))
    made.append(node("BASE-VARIANTS", variant))
    return made


def services_of(table: DiagnosticTable, dictionary: Dictionary) -> Iterator[Service]:
    """Yield all services of a table, those that it has of the standard's."""
    data, troubles = DataNames(table, dictionary), TroubleNames(table, dictionary)
    makers: dict[int, Callable[[], Iterator[Service]]] = {
        Number.SESSION_CONTROL: lambda: session_services(table, dictionary),
        Number.ECU_RESET: lambda: reset_services(table, dictionary),
        Number.CLEAR_CODES: lambda: clearing_services(table, dictionary, troubles),
        Number.READ_CODES: lambda: trouble_services(table, dictionary, troubles, data),
        Number.READ_DATA: lambda: reading_services(table, dictionary, data),
        Number.SECURITY_ACCESS: lambda: security_services(table, dictionary),
        Number.COMMUNICATION_CONTROL: lambda: communication_services(table, dictionary),
        Number.READ_PERIODICALLY: lambda: periodic_services(table, dictionary, data),
        Number.DEFINE_DATA: lambda: defining_services(table, dictionary, data),
        Number.WRITE_DATA: lambda: writing_services(table, dictionary, data),
        Number.CONTROL_DATA: lambda: controlling_services(table, dictionary, data),
        Number.ROUTINE_CONTROL: lambda: routine_services(table, dictionary),
        Number.TESTER_PRESENT: lambda: presence_services(table, dictionary),
        Number.CONTROL_CODE_SETTING: lambda: setting_services(table, dictionary),
    }
    for number, make in makers.items():
        if number in table.services:
            yield from make()
    if table.obd is not None and table.has_obd(Profile.UDS) and Number.READ_DATA in table.services:
        yield from emission_data_services(table, table.obd, dictionary)


def _protocol(name: str) -> Element:
    made = named("PROTOCOL", "LAYER", name)
    made.append(node("COMPARAM-SPEC-REF", {**_of_file(f"SPEC.{SPECIFICATION}", SPECIFICATION, "COMPARAM-SPEC")}))
    made.append(node("PROT-STACK-SNREF", {"SHORT-NAME": SPECIFICATION}))
    return made


def _of_file(identifier: str, file: str, kind: str) -> dict[str, str]:
    return {"ID-REF": identifier, "DOCREF": file, "DOCTYPE": kind}


def _variant(
    table: DiagnosticTable, protocol: str, services: list[Service], dictionary: Dictionary, states: States | None
) -> Element:
    """Return a BASE-VARIANT: the services of a controller by one protocol."""
    name = container_name(table) if protocol == PROTOCOL else obd_container_name(table)
    nrc = value("response_code", dictionary.simple("negative response code", worded(_codes(), 8)), 1)
    names = Names()
    by_name = {names.new(service.name): service for service in services}
    negatives = {number: f"negative_response_{number:02X}" for number in sorted({entry.number for entry in services})}
    made = named("BASE-VARIANT", "LAYER", name, table.name)
    parts = (
        dictionary.element(),
        listed("DIAG-COMMS", *_comms(table, by_name, negatives, states)),
        listed("REQUESTS", *(request_element(entry, name) for name, entry in by_name.items())),
        listed("POS-RESPONSES", *(part for name, entry in by_name.items() for part in response_elements(entry, name))),
        listed("NEG-RESPONSES", *(negative_element(number, name, nrc) for number, name in negatives.items())),
        None if states is None else states.charts(),
        node("COMPARAM-REFS", *communication_values(table, protocol)),
        node("PARENT-REFS", reference("PARENT-REF", "LAYER", protocol, **{"xsi:type": "PROTOCOL-REF"})),
    )
    made.extend(part for part in parts if part is not None)
    return made


def _comms(
    table: DiagnosticTable, by_name: dict[str, Service], negatives: dict[int, str], states: States | None
) -> Iterable[Element]:
    for name, service in by_name.items():
        text = _needs(table, service.access)
        needed = () if states is None else states.of(service)
        yield service_element(service, name, negatives[service.number], needed, text)


def _needs(table: DiagnosticTable, access: Access) -> str:
    """Return in words what must hold of the vehicle, for which ODX has no element."""
    if not access.conditions:
        return ""
    wanted = (f"{name} (else {table.conditions[name].nrc:02X})" for name in access.conditions)
    return f"Needs of the vehicle: {', '.join(wanted)}."


def _codes() -> dict[int, str]:
    return {int(nrc): nrc.name.lower().replace("_", " ") for nrc in Nrc}
