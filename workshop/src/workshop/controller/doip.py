"""ISO 13400-2 as pure functions: from received bytes or the time to a new state and actions."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, Final

from workshop.controller.table import DoipEntity

HEADER_BYTES: Final = 8
VERSION_2012: Final = 0x02
VERSION_2019: Final = 0x03
ANY_VERSION: Final = 0xFF  # of an identification request whose tester does not know the version
MOST_PAYLOAD_BYTES: Final = 0x10000  # longer messages are skipped
ADDRESSES_BYTES: Final = 4  # source and target before the data of a diagnostic message
MOST_ECHO_BYTES: Final = 64  # bytes of a diagnostic message that its acknowledgement repeats
_HEADER: Final = struct.Struct(">BBHL")


class PayloadType(IntEnum):
    HEADER_NACK = 0x0000
    IDENTIFY = 0x0001
    IDENTIFY_BY_EID = 0x0002
    IDENTIFY_BY_VIN = 0x0003
    ANNOUNCEMENT = 0x0004  # also the answer to the three identification requests
    ACTIVATE = 0x0005
    ACTIVATED = 0x0006
    ALIVE_CHECK = 0x0007
    ALIVE = 0x0008
    ENTITY_STATUS = 0x4001
    ENTITY_STATUS_RESPONSE = 0x4002
    POWER_MODE = 0x4003
    POWER_MODE_RESPONSE = 0x4004
    DIAGNOSTIC = 0x8001
    DIAGNOSTIC_ACK = 0x8002
    DIAGNOSTIC_NACK = 0x8003


class HeaderNack(IntEnum):
    """Codes of the generic negative acknowledge."""

    INCORRECT_PATTERN = 0x00
    UNKNOWN_PAYLOAD_TYPE = 0x01
    TOO_LARGE = 0x02
    OUT_OF_MEMORY = 0x03
    INVALID_LENGTH = 0x04


class DiagnosticNack(IntEnum):
    """Codes of the diagnostic message negative acknowledge."""

    INVALID_SOURCE = 0x02
    UNKNOWN_TARGET = 0x03
    TOO_LARGE = 0x04
    OUT_OF_MEMORY = 0x05


class Activation(IntEnum):
    """Response codes of a routing activation."""

    UNKNOWN_SOURCE = 0x00
    NO_SOCKET_LEFT = 0x01
    OTHER_SOURCE = 0x02  # this socket was activated for another tester
    SOURCE_IN_USE = 0x03  # another socket with this address is alive
    UNSUPPORTED_TYPE = 0x06
    ACTIVATED = 0x10


CLOSING_NACKS: Final = frozenset({HeaderNack.INCORRECT_PATTERN, HeaderNack.INVALID_LENGTH})
"""After these the socket is closed: the stream has lost its framing."""

ON_SOCKETS: Final[Mapping[int, range]] = {
    PayloadType.ACTIVATE: range(7, 12, 4),
    PayloadType.ALIVE_CHECK: range(1),
    PayloadType.ALIVE: range(2, 3),
    PayloadType.DIAGNOSTIC: range(ADDRESSES_BYTES + 1, MOST_PAYLOAD_BYTES + 1),
}
"""Messages that a tester may send over TCP, with the lengths of their payload [byte]."""

IN_DATAGRAMS: Final[Mapping[int, range]] = {
    PayloadType.IDENTIFY: range(1),
    PayloadType.IDENTIFY_BY_EID: range(6, 7),
    PayloadType.IDENTIFY_BY_VIN: range(17, 18),
    PayloadType.ENTITY_STATUS: range(1),
    PayloadType.POWER_MODE: range(1),
}
"""Messages that a tester may send over UDP, likewise."""

IDENTIFICATIONS: Final = frozenset({PayloadType.IDENTIFY, PayloadType.IDENTIFY_BY_EID, PayloadType.IDENTIFY_BY_VIN})
"""Identification requests; their tester may not know the version yet."""

ANSWERS: Final = frozenset(
    {
        PayloadType.HEADER_NACK,
        PayloadType.ANNOUNCEMENT,
        PayloadType.ACTIVATED,
        PayloadType.ENTITY_STATUS_RESPONSE,
        PayloadType.POWER_MODE_RESPONSE,
        PayloadType.DIAGNOSTIC_ACK,
        PayloadType.DIAGNOSTIC_NACK,
    }
)
"""Answers: they get no negative acknowledge, or two ends would exchange those for ever."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Header:
    """The first eight bytes of a message."""

    version: int
    inverse: int
    payload_type: int
    payload_bytes: int


def header_of(data: bytes) -> Header | None:
    """Return the header that data begin with, None while they are too short."""
    if len(data) < HEADER_BYTES:
        return None
    version, inverse, payload_type, payload_bytes = _HEADER.unpack_from(data)
    return Header(version=version, inverse=inverse, payload_type=payload_type, payload_bytes=payload_bytes)


def refusal_of(header: Header, known: Mapping[int, range]) -> HeaderNack | None:
    """Return why a header is refused, in the order of the standard's header handler; None if it is not.

    Parameters
    ----------
    header
        The header received.
    known
        Allowed payload types, with the lengths of their payload [byte].
    """
    if not _has_pattern(header, known):
        return HeaderNack.INCORRECT_PATTERN
    if header.payload_type in ANSWERS:
        return HeaderNack.TOO_LARGE if header.payload_bytes > MOST_PAYLOAD_BYTES else None
    if header.payload_type not in known:
        return HeaderNack.UNKNOWN_PAYLOAD_TYPE
    if header.payload_bytes > MOST_PAYLOAD_BYTES:
        return HeaderNack.TOO_LARGE
    if header.payload_bytes not in known[header.payload_type]:
        return HeaderNack.INVALID_LENGTH
    return None


def _has_pattern(header: Header, known: Mapping[int, range]) -> bool:
    """Return whether version and inverse version match, and the version is known."""
    is_asking = header.payload_type in IDENTIFICATIONS and header.payload_type in known
    versions = {VERSION_2012, VERSION_2019, *((ANY_VERSION,) if is_asking else ())}
    return header.version in versions and header.inverse == header.version ^ 0xFF


def message(version: int, payload_type: PayloadType, payload: bytes = b"") -> bytes:
    return _HEADER.pack(version, version ^ 0xFF, payload_type, len(payload)) + payload


def header_nack(version: int, code: HeaderNack) -> bytes:
    """Return a generic negative acknowledge."""
    return message(version, PayloadType.HEADER_NACK, bytes([code]))


def activation_response(version: int, tester: int, entity: int, code: Activation) -> bytes:
    """Return a routing activation response; its last four bytes are reserved."""
    return message(version, PayloadType.ACTIVATED, struct.pack(">HHBL", tester, entity, code, 0))


def diagnostic(version: int, source: int, target: int, data: bytes) -> bytes:
    return message(version, PayloadType.DIAGNOSTIC, struct.pack(">HH", source, target) + data)


def acknowledgement(version: int, source: int, target: int, code: DiagnosticNack | None, data: bytes) -> bytes:
    """Return the acknowledgement of a diagnostic message from ``target``; negative if there is a code."""
    kind = PayloadType.DIAGNOSTIC_ACK if code is None else PayloadType.DIAGNOSTIC_NACK
    return message(version, kind, struct.pack(">HHB", source, target, code or 0) + data[:MOST_ECHO_BYTES])


VIN_BYTES: Final = 17
NODE: Final = 0x01  # not a gateway: there is no other controller behind it
READY: Final = 0x01  # power mode
NO_FURTHER_ACTION: Final = 0x00
IS_SYNCHRONISED: Final = 0x00
IS_NOT_SYNCHRONISED: Final = 0x10  # VIN and group are not known yet


@dataclass(frozen=True, slots=True, kw_only=True)
class DatagramReply:
    """An answer by UDP; an identification is sent after a random pause, since all entities are asked at once."""

    data: bytes
    is_identification: bool


def announcement(entity: DoipEntity, vin: bytes, version: int) -> bytes:
    """Return a vehicle announcement, also the answer to an identification request; an invalid VIN becomes zeros."""
    is_known = len(vin) == VIN_BYTES
    payload = struct.pack(
        ">17sH6s6sBB",
        vin if is_known else bytes(VIN_BYTES),
        entity.logical_address,
        entity.eid.to_bytes(6, "big"),
        entity.gid.to_bytes(6, "big"),
        NO_FURTHER_ACTION,
        IS_SYNCHRONISED if is_known else IS_NOT_SYNCHRONISED,
    )
    return message(version, PayloadType.ANNOUNCEMENT, payload)


def datagram_reply(entity: DoipEntity, vin: bytes, open_sockets: int, data: bytes) -> DatagramReply | None:
    """Return the answer to a datagram; None if it asks for another vehicle or is an answer itself.

    Parameters
    ----------
    entity, vin
        The entity and its vehicle.
    open_sockets
        Number of TCP connections now.
    data
        One datagram with one message.
    """
    header = header_of(data)
    refusal = HeaderNack.INCORRECT_PATTERN if header is None else refusal_of(header, IN_DATAGRAMS)
    if header is None or refusal is HeaderNack.INCORRECT_PATTERN:
        return _immediate(header_nack(entity.version, HeaderNack.INCORRECT_PATTERN))
    if header.payload_type in ANSWERS:
        return None
    version = entity.version if header.version == ANY_VERSION else header.version
    payload = data[HEADER_BYTES:]
    if refusal is None and len(payload) != header.payload_bytes:
        refusal = HeaderNack.INVALID_LENGTH
    if refusal is not None:
        return _immediate(header_nack(version, refusal))
    return _datagram_answer(entity, vin, open_sockets, PayloadType(header.payload_type), payload, version)


def _datagram_answer(
    entity: DoipEntity, vin: bytes, open_sockets: int, kind: PayloadType, payload: bytes, version: int
) -> DatagramReply | None:
    if kind in IDENTIFICATIONS:
        is_meant = kind is PayloadType.IDENTIFY or payload in {entity.eid.to_bytes(6, "big"), vin}
        return DatagramReply(data=announcement(entity, vin, version), is_identification=True) if is_meant else None
    if kind is PayloadType.POWER_MODE:
        return _immediate(message(version, PayloadType.POWER_MODE_RESPONSE, bytes([READY])))
    status = struct.pack(">BBBL", NODE, entity.most_sockets, min(open_sockets, 0xFF), entity.most_request_bytes)
    return _immediate(message(version, PayloadType.ENTITY_STATUS_RESPONSE, status))


def _immediate(data: bytes) -> DatagramReply:
    return DatagramReply(data=data, is_identification=False)


MORE_CONNECTIONS: Final = 8  # connections beyond the activated ones; each is refused or closed within 2 s


@dataclass(frozen=True, slots=True, kw_only=True)
class WaitingActivation:
    """A routing activation that waits for the alive checks of other testers."""

    tester: int
    version: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Socket:
    """One TCP connection."""

    opened_s: float
    used_s: float  # time of the last data in either direction
    received: bytes = b""  # incomplete message
    skip_bytes: int = 0  # bytes to skip of a refused message
    version: int = 0  # protocol version of its tester
    tester: int | None = None  # its address, once routing is activated
    alive_until_s: float | None = None  # end of an alive check: without an answer it is closed then
    activation: WaitingActivation | None = None
    waiting_count: int = 0  # requests without a final response


@dataclass(frozen=True, slots=True, kw_only=True)
class Send:
    """Bytes for a connection."""

    number: int
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Close:
    """Close a connection once all data were sent."""

    number: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Ask:
    """A request for the controller."""

    number: int
    payload: bytes
    is_functional: bool


Action = Send | Close | Ask


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """All connections, and the actions since the last step."""

    sockets: Mapping[int, Socket]
    actions: tuple[Action, ...] = ()

    def changed(self, number: int, **values: Any) -> "Step":  # noqa: ANN401 - the members of a socket
        return replace(self, sockets={**self.sockets, number: replace(self.sockets[number], **values)})

    def sending(self, number: int, data: bytes, t_s: float) -> "Step":
        """Return the step with data to send to one tester."""
        return replace(self.changed(number, used_s=t_s), actions=(*self.actions, Send(number=number, data=data)))

    def asking(self, ask: Ask) -> "Step":
        """Return the step with a request for the controller."""
        more = self.sockets[ask.number].waiting_count + 1
        return replace(self.changed(ask.number, waiting_count=more), actions=(*self.actions, ask))

    def closing(self, number: int) -> "Step":
        return replace(self.forgetting(number), actions=(*self.actions, Close(number=number)))

    def forgetting(self, number: int) -> "Step":
        """Return the step without a connection."""
        return replace(self, sockets={key: socket for key, socket in self.sockets.items() if key != number})

    def done(self) -> "Step":
        """Return the step without actions."""
        return replace(self, actions=())


MOST_WAITING: Final = 32  # waiting requests of one tester


def activate(entity: DoipEntity, step: Step, number: int, payload: bytes, version: int, t_s: float) -> Step:
    """Return the step after a routing activation request, checked in the order of the standard."""
    tester, kind = struct.unpack_from(">HB", payload)
    activation = WaitingActivation(tester=tester, version=version)
    socket = step.sockets[number]
    if not entity.first_tester <= tester <= entity.last_tester:
        return _refused(entity, step, number, activation, Activation.UNKNOWN_SOURCE, t_s)
    if kind not in entity.activation_types:
        return _refused(entity, step, number, activation, Activation.UNSUPPORTED_TYPE, t_s)
    if socket.tester is not None and socket.tester != tester:
        return _refused(entity, step, number, activation, Activation.OTHER_SOURCE, t_s)
    if socket.tester == tester:
        return _respond_activation(entity, step, number, activation, Activation.ACTIVATED, t_s)
    for rival in _rivals(entity, step, number, tester):
        if step.sockets[rival].alive_until_s is None:
            check = message(step.sockets[rival].version, PayloadType.ALIVE_CHECK)
            used_s = step.sockets[rival].used_s  # an alive check does not count as use
            step = step.sending(rival, check, used_s).changed(rival, alive_until_s=t_s + entity.alive_check_s)
    return decide_activations(entity, step.changed(number, activation=activation), t_s)


def decide_activations(entity: DoipEntity, step: Step, t_s: float) -> Step:
    """Return the step with waiting activations granted if there is room, refused if all rivals are alive."""
    for number in list(step.sockets):
        socket = step.sockets.get(number)
        if socket is not None and socket.activation is not None:
            step = _decide(entity, step, number, socket.activation, t_s)
    return step


def _decide(entity: DoipEntity, step: Step, number: int, activation: WaitingActivation, t_s: float) -> Step:
    rivals = _rivals(entity, step, number, activation.tester)
    if not rivals:
        step = step.changed(number, activation=None, tester=activation.tester, version=activation.version)
        return _respond_activation(entity, step, number, activation, Activation.ACTIVATED, t_s)
    if any(step.sockets[rival].alive_until_s is not None for rival in rivals):
        return step
    is_in_use = any(step.sockets[rival].tester == activation.tester for rival in rivals)
    code = Activation.SOURCE_IN_USE if is_in_use else Activation.NO_SOCKET_LEFT
    return _refused(entity, step, number, activation, code, t_s)


def _rivals(entity: DoipEntity, step: Step, number: int, tester: int) -> list[int]:
    """Return the connections that block an activation: those of the same tester, or all if no socket is left."""
    others = {key: socket for key, socket in step.sockets.items() if key != number and socket.tester is not None}
    same = [key for key, socket in others.items() if socket.tester == tester]
    if same:
        return same
    active_count = sum(socket.tester is not None for socket in others.values())
    return list(others) if active_count >= entity.most_sockets else []


def _refused(
    entity: DoipEntity, step: Step, number: int, activation: WaitingActivation, code: Activation, t_s: float
) -> Step:
    return _respond_activation(entity, step, number, activation, code, t_s).closing(number)


def _respond_activation(
    entity: DoipEntity, step: Step, number: int, activation: WaitingActivation, code: Activation, t_s: float
) -> Step:
    response = activation_response(activation.version, activation.tester, entity.logical_address, code)
    return step.sending(number, response, t_s)


def opened(step: Step, number: int, t_s: float) -> Step:
    return Step(sockets={**step.sockets, number: Socket(opened_s=t_s, used_s=t_s)}, actions=step.actions)


def closed(entity: DoipEntity, step: Step, number: int, t_s: float) -> Step:
    """Return the step after a tester has closed its connection, which may free an activation."""
    return decide_activations(entity, step.forgetting(number), t_s)


def received(entity: DoipEntity, step: Step, number: int, data: bytes, t_s: float) -> Step:
    """Return the step after bytes of one connection; the result does not depend on how the stream was cut.

    Parameters
    ----------
    entity, step
        The entity and its connections.
    number, data
        The connection and its bytes.
    t_s
        Monotonic time [s].
    """
    if number not in step.sockets:
        return step
    step = step.changed(number, used_s=t_s, received=step.sockets[number].received + data)
    while (socket := step.sockets.get(number)) is not None:
        if socket.skip_bytes and socket.received:
            count = min(socket.skip_bytes, len(socket.received))
            step = step.changed(number, received=socket.received[count:], skip_bytes=socket.skip_bytes - count)
            continue
        if (after := _next_message(entity, step, number, socket, t_s)) is None:
            break
        step = after
    return step


def _next_message(entity: DoipEntity, step: Step, number: int, socket: Socket, t_s: float) -> Step | None:
    """Return the step after the first message of the stream, None if it is incomplete."""
    header = header_of(socket.received)
    if header is None:
        return None
    refusal = refusal_of(header, ON_SOCKETS)
    if refusal is not None:
        version = entity.version if refusal is HeaderNack.INCORRECT_PATTERN else header.version
        step = step.sending(number, header_nack(version, refusal), t_s)
        if refusal in CLOSING_NACKS:
            return decide_activations(entity, step.closing(number), t_s)
    if refusal is not None or header.payload_type in ANSWERS:
        return step.changed(number, received=socket.received[HEADER_BYTES:], skip_bytes=header.payload_bytes)
    end = HEADER_BYTES + header.payload_bytes
    if len(socket.received) < end:
        return None
    payload = socket.received[HEADER_BYTES:end]
    step = step.changed(number, received=socket.received[end:], version=header.version)
    return _handle(entity, step, number, PayloadType(header.payload_type), payload, t_s)


def _handle(entity: DoipEntity, step: Step, number: int, kind: PayloadType, payload: bytes, t_s: float) -> Step:
    socket = step.sockets[number]
    match kind:
        case PayloadType.ACTIVATE:
            return activate(entity, step, number, payload, socket.version, t_s)
        case PayloadType.ALIVE:
            is_alive = int.from_bytes(payload, "big") == socket.tester
            return decide_activations(entity, step.changed(number, alive_until_s=None), t_s) if is_alive else step
        case PayloadType.ALIVE_CHECK:  # meant for testers, but answered
            alive = message(socket.version, PayloadType.ALIVE, entity.logical_address.to_bytes(2, "big"))
            return step.sending(number, alive, t_s)
        case _:
            return _handle_diagnostic(entity, step, number, payload, t_s)


def _handle_diagnostic(entity: DoipEntity, step: Step, number: int, payload: bytes, t_s: float) -> Step:
    """Return the step after a diagnostic message: an acknowledgement and, if positive, a request."""
    socket = step.sockets[number]
    source, target = struct.unpack_from(">HH", payload)
    data = payload[ADDRESSES_BYTES:]
    code = _nack(entity, socket, source, target, len(data))
    step = step.sending(number, acknowledgement(socket.version, target, source, code, data), t_s)
    if code is DiagnosticNack.INVALID_SOURCE:
        return decide_activations(entity, step.closing(number), t_s)
    if code is not None:
        return step
    return step.asking(Ask(number=number, payload=data, is_functional=target == entity.functional_address))


def _nack(entity: DoipEntity, socket: Socket, source: int, target: int, data_bytes: int) -> DiagnosticNack | None:
    """Return why a diagnostic message is refused, checked in the order of the standard; None if it is accepted."""
    if socket.tester is None or source != socket.tester:
        return DiagnosticNack.INVALID_SOURCE
    if target not in {entity.logical_address, entity.functional_address}:
        return DiagnosticNack.UNKNOWN_TARGET
    if data_bytes > entity.most_request_bytes:
        return DiagnosticNack.TOO_LARGE
    return DiagnosticNack.OUT_OF_MEMORY if socket.waiting_count >= MOST_WAITING else None


def responded(
    entity: DoipEntity, step: Step, number: int, response: bytes | None, t_s: float, *, is_final: bool
) -> Step:
    """Return the step after the controller's response, or none, to a request of one connection.

    Parameters
    ----------
    response, is_final
        The response, and whether it is the last: another one follows 78.
    """
    socket = step.sockets.get(number)
    if socket is None:
        return step
    if response is not None and socket.tester is not None:
        step = step.sending(number, diagnostic(socket.version, entity.logical_address, socket.tester, response), t_s)
    return step.changed(number, waiting_count=socket.waiting_count - 1) if is_final else step


def advanced(entity: DoipEntity, step: Step, t_s: float) -> Step:
    """Return the step after time has passed: inactive connections are closed, waiting activations decided."""
    for number, socket in step.sockets.items():
        if _is_over(entity, socket, t_s):
            step = step.closing(number)
    return decide_activations(entity, step, t_s)


def _is_over(entity: DoipEntity, socket: Socket, t_s: float) -> bool:
    if socket.alive_until_s is not None and t_s >= socket.alive_until_s:
        return True
    if socket.tester is None and socket.activation is None:
        return t_s - socket.opened_s >= entity.initial_inactivity_s
    return t_s - socket.used_s >= entity.general_inactivity_s
