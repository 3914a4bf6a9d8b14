"""Routing activation: who may use a socket, and what becomes of testers that have gone without saying so."""

import struct

from ecu_emulator.diagnostics.doip.messages import Activation, PayloadType, activation_response, message
from ecu_emulator.diagnostics.doip.sockets import Step, Wish, active_count
from ecu_emulator.diagnostics.table import DoipEntity


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
    return list(others) if active_count(others) >= entity.most_sockets else []


def _refused(entity: DoipEntity, step: Step, number: int, wish: Wish, code: Activation, t_s: float) -> Step:
    return _said(entity, step, number, wish, code, t_s).closing(number)


def _said(entity: DoipEntity, step: Step, number: int, wish: Wish, code: Activation, t_s: float) -> Step:
    response = activation_response(wish.version, wish.tester, entity.logical_address, code)
    return step.sending(number, response, t_s)
