"""What comes over TCP and what time brings: bytes and a moment in, bytes, requests and closed connections out."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from workshop.controller.doip.messages import (
    ADDRESSES_BYTES,
    ANSWERS,
    CLOSING_NACKS,
    HEADER_BYTES,
    ON_SOCKETS,
    Activation,
    DiagnosticNack,
    HeaderNack,
    PayloadType,
    acknowledgement,
    activation_response,
    diagnostic,
    header_nack,
    header_of,
    message,
    refusal_of,
)
from workshop.controller.table import DoipEntity

MORE_CONNECTIONS: Final = 8  # beside those that may be activated: each is told that it may not, or closed in 2 s


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """A routing activation that waits for other testers to say that they are alive."""

    tester: int
    version: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Socket:
    """One TCP connection."""

    opened_s: float
    used_s: float  # when data came or went
    received: bytes = b""  # not yet a whole message
    skip_bytes: int = 0  # of a message that is passed over
    version: int = 0  # that its tester speaks
    tester: int | None = None  # its address, once routing is activated
    alive_until_s: float | None = None  # its tester was asked whether it is alive; closed then
    wish: Wish | None = None
    waiting_count: int = 0  # requests that the controller has not answered


@dataclass(frozen=True, slots=True, kw_only=True)
class Send:
    """Bytes for a connection."""

    number: int
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Close:
    """A connection that ends once what was said before has gone out."""

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
    """All connections, and what is to be done since the step before."""

    sockets: Mapping[int, Socket]
    actions: tuple[Action, ...] = ()

    def changed(self, number: int, **values: Any) -> "Step":  # noqa: ANN401 - the members of a socket
        return replace(self, sockets={**self.sockets, number: replace(self.sockets[number], **values)})

    def sending(self, number: int, data: bytes, t_s: float) -> "Step":
        """Return the step with something said to one tester."""
        return replace(self.changed(number, used_s=t_s), actions=(*self.actions, Send(number=number, data=data)))

    def asking(self, ask: Ask) -> "Step":
        """Return the step with a request handed to the controller."""
        more = self.sockets[ask.number].waiting_count + 1
        return replace(self.changed(ask.number, waiting_count=more), actions=(*self.actions, ask))

    def closing(self, number: int) -> "Step":
        return replace(self.forgetting(number), actions=(*self.actions, Close(number=number)))

    def forgetting(self, number: int) -> "Step":
        """Return the step without a connection that its tester has closed."""
        return replace(self, sockets={key: socket for key, socket in self.sockets.items() if key != number})

    def done(self) -> "Step":
        """Return the step with nothing left to do."""
        return replace(self, actions=())


MOST_WAITING: Final = 32  # requests of one tester that wait for the controller


def wished(entity: DoipEntity, step: Step, number: int, payload: bytes, version: int, t_s: float) -> Step:
    """Return what follows from a routing activation request; the order of checks is that of the standard's handler."""
    tester, kind = struct.unpack_from(">HB", payload)
    wish = Wish(tester=tester, version=version)
    own = step.sockets[number]
    if not entity.first_tester <= tester <= entity.last_tester:
        return _refused(entity, step, number, wish, Activation.UNKNOWN_SOURCE, t_s)
    if kind not in entity.activation_types:
        return _refused(entity, step, number, wish, Activation.UNSUPPORTED_TYPE, t_s)
    if own.tester is not None and own.tester != tester:
        return _refused(entity, step, number, wish, Activation.OTHER_SOURCE, t_s)
    if own.tester == tester:
        return _said(entity, step, number, wish, Activation.ACTIVATED, t_s)
    for rival in _rivals(entity, step, number, tester):
        if step.sockets[rival].alive_until_s is None:
            check = message(step.sockets[rival].version, PayloadType.ALIVE_CHECK)
            used_s = step.sockets[rival].used_s  # being asked is no use
            step = step.sending(rival, check, used_s).changed(rival, alive_until_s=t_s + entity.alive_check_s)
    return settled(entity, step.changed(number, wish=wish), t_s)


def settled(entity: DoipEntity, step: Step, t_s: float) -> Step:
    """Return what follows for activations that wait: granted once there is room, refused once all others are alive."""
    for number in list(step.sockets):
        socket = step.sockets.get(number)
        if socket is not None and socket.wish is not None:
            step = _judged(entity, step, number, socket.wish, t_s)
    return step


def _judged(entity: DoipEntity, step: Step, number: int, wish: Wish, t_s: float) -> Step:
    rivals = _rivals(entity, step, number, wish.tester)
    if not rivals:
        step = step.changed(number, wish=None, tester=wish.tester, version=wish.version)
        return _said(entity, step, number, wish, Activation.ACTIVATED, t_s)
    if any(step.sockets[rival].alive_until_s is not None for rival in rivals):
        return step
    is_in_use = any(step.sockets[rival].tester == wish.tester for rival in rivals)
    code = Activation.SOURCE_IN_USE if is_in_use else Activation.NO_SOCKET_LEFT
    return _refused(entity, step, number, wish, code, t_s)


def _rivals(entity: DoipEntity, step: Step, number: int, tester: int) -> list[int]:
    """Return the connections of which one must end first: the same tester's, or all if no more may be activated."""
    others = {key: socket for key, socket in step.sockets.items() if key != number and socket.tester is not None}
    same = [key for key, socket in others.items() if socket.tester == tester]
    if same:
        return same
    active_count = sum(socket.tester is not None for socket in others.values())
    return list(others) if active_count >= entity.most_sockets else []


def _refused(entity: DoipEntity, step: Step, number: int, wish: Wish, code: Activation, t_s: float) -> Step:
    return _said(entity, step, number, wish, code, t_s).closing(number)


def _said(entity: DoipEntity, step: Step, number: int, wish: Wish, code: Activation, t_s: float) -> Step:
    response = activation_response(wish.version, wish.tester, entity.logical_address, code)
    return step.sending(number, response, t_s)


def opened(step: Step, number: int, t_s: float) -> Step:
    return Step(sockets={**step.sockets, number: Socket(opened_s=t_s, used_s=t_s)}, actions=step.actions)


def closed(entity: DoipEntity, step: Step, number: int, t_s: float) -> Step:
    """Return the step after a tester has closed its connection; another may have waited for that."""
    return settled(entity, step.forgetting(number), t_s)


def received(entity: DoipEntity, step: Step, number: int, data: bytes, t_s: float) -> Step:
    """Return what follows from bytes of one connection, however the stream was cut.

    Parameters
    ----------
    entity, step
        Who is asked, and its connections.
    number, data
        The connection, and what came.
    t_s
        The time, of a clock that never goes back.
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
    """Return what follows from the message that the stream begins with, None if it is not all there."""
    header = header_of(socket.received)
    if header is None:
        return None
    refusal = refusal_of(header, ON_SOCKETS)
    if refusal is not None:
        version = entity.version if refusal is HeaderNack.INCORRECT_PATTERN else header.version
        step = step.sending(number, header_nack(version, refusal), t_s)
        if refusal in CLOSING_NACKS:
            return settled(entity, step.closing(number), t_s)
    if refusal is not None or header.payload_type in ANSWERS:
        return step.changed(number, received=socket.received[HEADER_BYTES:], skip_bytes=header.payload_bytes)
    end = HEADER_BYTES + header.payload_bytes
    if len(socket.received) < end:
        return None
    payload = socket.received[HEADER_BYTES:end]
    step = step.changed(number, received=socket.received[end:], version=header.version)
    return _done(entity, step, number, PayloadType(header.payload_type), payload, t_s)


def _done(entity: DoipEntity, step: Step, number: int, kind: PayloadType, payload: bytes, t_s: float) -> Step:
    socket = step.sockets[number]
    match kind:
        case PayloadType.ACTIVATE:
            return wished(entity, step, number, payload, socket.version, t_s)
        case PayloadType.ALIVE:
            is_alive = int.from_bytes(payload, "big") == socket.tester
            return settled(entity, step.changed(number, alive_until_s=None), t_s) if is_alive else step
        case PayloadType.ALIVE_CHECK:  # meant for testers; one that asks is told
            alive = message(socket.version, PayloadType.ALIVE, entity.logical_address.to_bytes(2, "big"))
            return step.sending(number, alive, t_s)
        case _:
            return _diagnosed(entity, step, number, payload, t_s)


def _diagnosed(entity: DoipEntity, step: Step, number: int, payload: bytes, t_s: float) -> Step:
    """Return what follows from a diagnostic message: an acknowledgement and, if it is positive, a request."""
    socket = step.sockets[number]
    source, target = struct.unpack_from(">HH", payload)
    data = payload[ADDRESSES_BYTES:]
    code = _nack(entity, socket, source, target, len(data))
    step = step.sending(number, acknowledgement(socket.version, target, source, code, data), t_s)
    if code is DiagnosticNack.INVALID_SOURCE:
        return settled(entity, step.closing(number), t_s)
    if code is not None:
        return step
    return step.asking(Ask(number=number, payload=data, is_functional=target == entity.functional_address))


def _nack(entity: DoipEntity, socket: Socket, source: int, target: int, data_bytes: int) -> DiagnosticNack | None:
    """Return why a diagnostic message is not taken, in the order of the standard's handler."""
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
    """Return what follows from the controller's response to a request of one connection, which may be none.

    Parameters
    ----------
    response, is_final
        What it says, and whether it is done with the request: 78 is followed by another response.
    """
    socket = step.sockets.get(number)
    if socket is None:
        return step
    if response is not None and socket.tester is not None:
        step = step.sending(number, diagnostic(socket.version, entity.logical_address, socket.tester, response), t_s)
    return step.changed(number, waiting_count=socket.waiting_count - 1) if is_final else step


def advanced(entity: DoipEntity, step: Step, t_s: float) -> Step:
    """Return what time alone does: connections that say nothing are closed, activations that waited are decided."""
    for number, socket in step.sockets.items():
        if _is_over(entity, socket, t_s):
            step = step.closing(number)
    return settled(entity, step, t_s)


def _is_over(entity: DoipEntity, socket: Socket, t_s: float) -> bool:
    if socket.alive_until_s is not None and t_s >= socket.alive_until_s:
        return True
    if socket.tester is None and socket.wish is None:
        return t_s - socket.opened_s >= entity.initial_inactivity_s
    return t_s - socket.used_s >= entity.general_inactivity_s
