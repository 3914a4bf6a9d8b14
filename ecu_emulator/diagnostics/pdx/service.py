"""One service as a tool offers it: a request, its responses, and when it may be asked."""

from dataclasses import dataclass
from typing import Final
from xml.etree.ElementTree import Element

from ecu_emulator.diagnostics.codes import NEGATIVE, POSITIVE
from ecu_emulator.diagnostics.descriptions import Access
from ecu_emulator.diagnostics.pdx.elements import listed, named, node, reference
from ecu_emulator.diagnostics.pdx.parameters import Parameter, placed, service_id, sub_function
from ecu_emulator.diagnostics.table import DiagnosticTable

SUPPRESS_BIT: Final = "80"


@dataclass(frozen=True, slots=True, kw_only=True)
class Service:
    """A service of the ODX file: for people a task, on the wire one kind of request."""

    name: str
    number: int  # of ISO 14229-1
    semantic: str
    request: tuple[Parameter, ...] = ()  # after the service's number
    responses: tuple[tuple[Parameter, ...], ...] = ((),)  # likewise; one of them comes
    access: Access
    enters: int | None = None  # a session
    unlocks: int | None = None  # a security level
    resets: bool = False


def simple(
    name: str,
    number: int,
    sub: int,
    semantic: str,
    access: Access,
    *,
    request: tuple[Parameter, ...] = (),
    response: tuple[Parameter, ...] = (),
    enters: int | None = None,
    unlocks: int | None = None,
    resets: bool = False,
) -> Service:
    """Return a service with a sub-function, which its response repeats."""
    return Service(
        name=name,
        number=number,
        semantic=semantic,
        request=(sub_function(sub), *request),
        responses=((sub_function(sub), *response),),
        access=access,
        enters=enters,
        unlocks=unlocks,
        resets=resets,
    )


def access_to(table: DiagnosticTable, number: int, access: Access | None = None) -> Access:
    """Return who may use a service, or do with it what needs an access of its own."""
    service = table.services[number]
    if access is None:
        return Access(sessions=service.sessions, levels=service.levels, conditions=service.conditions)
    levels = service.levels or access.levels
    if service.levels and access.levels:
        levels = tuple(level for level in service.levels if level in access.levels)
    return Access(
        sessions=tuple(session for session in service.sessions if session in access.sessions),
        levels=levels,
        conditions=(*service.conditions, *access.conditions),
    )


def request_element(service: Service, name: str) -> Element:
    """Return the REQUEST of a service."""
    made = named("REQUEST", "REQUEST", name)
    made.append(placed((service_id(service.number), *service.request)))
    return made


def response_elements(service: Service, name: str) -> list[Element]:
    """Return the POS-RESPONSES of a service."""
    made = []
    for place, parameters in enumerate(service.responses):
        element = named("POS-RESPONSE", "RESPONSE", _response_name(name, place))
        element.append(placed((service_id(service.number + POSITIVE), *parameters)))
        made.append(element)
    return made


def negative_element(number: int, name: str, nrc: Parameter) -> Element:
    """Return the NEG-RESPONSE to every request with this number."""
    made = named("NEG-RESPONSE", "RESPONSE", name)
    refused = Parameter(name="request_service", size_bytes=1, constant=number, semantic="SERVICEIDRQ")
    made.append(placed((service_id(NEGATIVE), refused, nrc)))
    return made


def service_element(
    service: Service, name: str, negative: str, states: tuple[Element | None, ...], text: str
) -> Element:
    """Return the DIAG-SERVICE."""
    made = named(
        "DIAG-SERVICE",
        "SERVICE",
        name,
        service.name if service.name != name else "",
        text,
        SEMANTIC=service.semantic,
        ADDRESSING="FUNCTIONAL-OR-PHYSICAL",
    )
    positive = (
        reference("POS-RESPONSE-REF", "RESPONSE", _response_name(name, place))
        for place in range(len(service.responses))
    )
    parts = (
        *states,
        reference("REQUEST-REF", "REQUEST", name),
        listed("POS-RESPONSE-REFS", *positive),
        node("NEG-RESPONSE-REFS", reference("NEG-RESPONSE-REF", "RESPONSE", negative)),
        _suppressible() if any(entry.semantic == "SUBFUNCTION" for entry in service.request) else None,
    )
    made.extend(part for part in parts if part is not None)
    return made


def _suppressible() -> Element:
    name = node("CODED-CONST-SNREF", {"SHORT-NAME": "sub_function"})
    return node("POS-RESPONSE-SUPPRESSABLE", node("BIT-MASK", SUPPRESS_BIT), name)


def _response_name(name: str, place: int) -> str:
    return f"{name}_response" if place == 0 else f"{name}_response_{place + 1}"
