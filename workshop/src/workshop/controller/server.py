"""A diagnostic server as a function: a request and the state before it in, a response or none and the new state out.

Checks follow the general server response behaviour of ISO 14229-1: service, session and security of the service;
length, sub-function, session of the sub-function; then the checks of each service.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Final

from workshop.controller.iso14229 import (
    DEFAULT_SESSION,
    NEGATIVE,
    SILENT_WHEN_FUNCTIONAL,
    SUPPRESS,
    Nrc,
    Service,
)
from workshop.controller.memory import (
    NOTHING_CAPTURED,
    TestResult,
    after_cycle,
    after_test,
    after_warm_up,
    begin_cycle,
    empty_memory,
    located,
    needs_capture,
    note_warm_up,
    report,
)
from workshop.controller.services import data, sessions
from workshop.controller.services.obd import OBD_HANDLERS
from workshop.controller.services.trouble import REPORTS, capture, clear_codes, read_codes
from workshop.controller.state import (
    Call,
    Instant,
    KeptState,
    Reply,
    Request,
    Result,
    ServerState,
    ServiceOutcome,
    Waiting,
    is_unlocked,
)
from workshop.controller.table import DiagnosticTable

AGAIN_RATIO: Final = 0.7  # fraction of P2* after which 78 is repeated
PENDING_RATIO: Final = 0.6  # fraction of P2 after which 78 is sent
KEEP_ALIVE: Final = bytes([Service.TESTER_PRESENT, SUPPRESS])  # TesterPresent without response: not even 78 is sent

_HANDLERS: Final[Mapping[int, Callable[[Call], Result]]] = {
    Service.SESSION_CONTROL: sessions.session_control,
    Service.ECU_RESET: sessions.ecu_reset,
    Service.CLEAR_CODES: clear_codes,
    Service.READ_CODES: read_codes,
    Service.READ_DATA: data.read_data,
    Service.SECURITY_ACCESS: sessions.security_access,
    Service.COMMUNICATION_CONTROL: sessions.communication_control,
    Service.DEFINE_DATA: data.define_data,
    Service.WRITE_DATA: data.write_data,
    Service.ROUTINE_CONTROL: sessions.routine_control,
    Service.TESTER_PRESENT: sessions.tester_present,
    Service.CONTROL_CODE_SETTING: sessions.control_code_setting,
}
_SUB_FUNCTIONS: Final[Mapping[int, frozenset[int]]] = {
    Service.ECU_RESET: frozenset({sessions.HARD_RESET, sessions.KEY_OFF_ON_RESET, sessions.SOFT_RESET}),
    Service.READ_CODES: REPORTS,
    Service.COMMUNICATION_CONTROL: frozenset({0x00, 0x01, 0x02, 0x03}),
    Service.DEFINE_DATA: frozenset({data.DEFINE_BY_IDENTIFIER, data.CLEAR_DEFINITION}),
    Service.ROUTINE_CONTROL: frozenset({sessions.START, sessions.STOP, sessions.RESULTS}),
    Service.TESTER_PRESENT: frozenset({0x00}),
    Service.CONTROL_CODE_SETTING: frozenset({sessions.CODES_ON, sessions.CODES_OFF}),
}  # sub-functions of services 10 and 27 are in the table


def switched_on(table: DiagnosticTable, kept: KeptState | None, t_s: float) -> ServerState:
    """Return the state at power-on; ``kept`` is the content of the memory file."""
    return sessions.started(kept or KeptState(memory=empty_memory(table.troubles)), table, t_s)


def answer(table: DiagnosticTable, state: ServerState, request: Request, moment: Instant) -> Reply:
    """Return the reply to a request.

    Parameters
    ----------
    table, state
        Description and state of the controller.
    request
        The reassembled request.
    moment
        Time, values of the vehicle, and random bytes for a seed.

    Returns
    -------
    Reply
        The response or none, and the state after it. After 78 the final response comes from ``advance``.
    """
    if moment.t_s < state.asleep_until_s or not request.payload:
        return Reply(payload=None, state=state)
    state = _after_time(table, state, moment)
    if state.waiting is not None:  # everything but KEEP_ALIVE is refused
        busy = None if request.payload == KEEP_ALIVE else _negative(request, Nrc.BUSY_REPEAT_REQUEST)
        return Reply(payload=busy, state=state)
    result = _outcome(Call(table=table, state=state, moment=moment, request=request))
    if not result.is_final:
        waiting = Waiting(
            request=request,
            routine=int.from_bytes(request.payload[2:4], "big"),
            again_s=moment.t_s + AGAIN_RATIO * table.timing.p2_star_s,
        )
        return Reply(payload=_negative(request, Nrc.RESPONSE_PENDING), state=replace(result.state, waiting=waiting))
    return _replied(request, result.response, result.state)


def _outcome(call: Call) -> ServiceOutcome:
    """Return the outcome of a service for the holder of the session or for a guest."""
    before, number = call.state, call.payload[0]
    is_guest = before.session != DEFAULT_SESSION and call.request.client != before.holder
    visible = sessions.as_guest(before) if is_guest else replace(before, heard_s=call.moment.t_s)
    call = replace(call, state=visible, is_guest=is_guest)
    result = OBD_HANDLERS[number](call) if _is_obd(call) else _refusal(call) or _HANDLERS[number](call)
    if isinstance(result, Nrc):
        result = ServiceOutcome(response=result, state=call.state)
    return replace(result, state=sessions.after_guest(before, result.state)) if is_guest else result


def advance(table: DiagnosticTable, state: ServerState, moment: Instant) -> Reply:
    """Return the final response of an awaited routine, or 78 again, once it is due."""
    state = _after_time(table, state, moment)
    waiting = state.waiting
    if waiting is None:
        return Reply(payload=None, state=state)
    run = state.routines[waiting.routine]
    if run.is_running and moment.t_s < waiting.again_s:
        return Reply(payload=None, state=state)
    if run.is_running:
        waiting = replace(waiting, again_s=moment.t_s + AGAIN_RATIO * table.timing.p2_star_s)
        return Reply(payload=_negative(waiting.request, Nrc.RESPONSE_PENDING), state=replace(state, waiting=waiting))
    state = replace(state, waiting=None, heard_s=moment.t_s)
    if run.failed_nrc:
        return Reply(payload=_negative(waiting.request, Nrc(run.failed_nrc)), state=state)
    call = Call(table=table, state=state, moment=moment, request=waiting.request)
    response = sessions.routine_response(call, table.routines[waiting.routine], run).response
    return Reply(payload=response if isinstance(response, bytes) else None, state=state)


def extend_session(table: DiagnosticTable, state: ServerState, moment: Instant) -> ServerState:
    """Return the state with S3 restarted, as while a message is being transferred."""
    return replace(_after_time(table, state, moment), heard_s=moment.t_s)


def disconnect(state: ServerState, client: int) -> ServerState:
    """Return the state without a client's pending response and session."""
    if state.waiting is not None and state.waiting.request.client == client:
        state = replace(state, waiting=None)
    is_held = state.session != DEFAULT_SESSION and state.holder == client
    return sessions.in_session(state, DEFAULT_SESSION) if is_held else state


def tested(table: DiagnosticTable, state: ServerState, number: int, result: TestResult, moment: Instant) -> ServerState:
    """Return the state after a test result; service 85 can switch its recording off."""
    if not state.are_codes_updated:
        return state
    trouble = table.troubles[number]
    is_new = needs_capture(state.memory, trouble, result)
    captured = capture(table, state, moment) if is_new else NOTHING_CAPTURED
    memory = report(state.memory, trouble, result, captured)
    odometer_m = data.odometer_m(moment)
    frozen = partial(data.frozen_pids, table, state, moment)
    emissions = after_test(state.emissions, trouble, state.memory, memory, odometer_m, frozen)
    return replace(state, memory=memory, emissions=located(emissions, memory, odometer_m))


def warmed_up(state: ServerState) -> ServerState:
    """Return the state with the operation cycle marked as a warm-up cycle, which counts for ageing."""
    memory = note_warm_up(state.memory)
    return replace(state, memory=memory, emissions=after_warm_up(state.emissions, state.memory, memory))


def cycled(table: DiagnosticTable, state: ServerState) -> ServerState:
    """Return the state after the ignition was switched off and on while the controller stayed powered."""
    memory = begin_cycle(state.memory, table.troubles)
    return replace(state, memory=memory, emissions=after_cycle(state.emissions, state.memory, memory))


def _after_time(table: DiagnosticTable, state: ServerState, moment: Instant) -> ServerState:
    """Return the state with expired routines, delays and sessions ended."""
    state = sessions.timed_out(state, table, moment)
    for level in table.levels.values():
        state = sessions.delay_over(state, level, moment.t_s)
    is_over = moment.t_s - state.heard_s >= table.timing.s3_s
    if state.session != DEFAULT_SESSION and state.waiting is None and is_over:
        return sessions.in_session(state, DEFAULT_SESSION)
    return state


def _is_obd(call: Call) -> bool:
    return call.payload[0] in OBD_HANDLERS and call.table.obd is not None


def _refusal(call: Call) -> Nrc | None:
    service = call.table.services.get(call.payload[0])
    if service is None or service.number not in _HANDLERS:
        return Nrc.SERVICE_NOT_SUPPORTED
    if call.state.session not in service.sessions:
        return Nrc.SERVICE_NOT_SUPPORTED_IN_SESSION
    if not is_unlocked(call.state, service.levels):
        return Nrc.SECURITY_ACCESS_DENIED
    return _sub_function_refusal(call) if _has_sub_function(service.number) else None


def _sub_function_refusal(call: Call) -> Nrc | None:
    if len(call.payload) < 2:
        return Nrc.INCORRECT_LENGTH
    there = _sessions_of_sub_function(call)
    if not there:
        return Nrc.SUB_FUNCTION_NOT_SUPPORTED
    return None if call.state.session in there else Nrc.SUB_FUNCTION_NOT_SUPPORTED_IN_SESSION


def _has_sub_function(service: int) -> bool:
    return service in _SUB_FUNCTIONS or service in {Service.SESSION_CONTROL, Service.SECURITY_ACCESS}


def _sessions_of_sub_function(call: Call) -> tuple[int, ...]:
    """Return the sessions that allow a sub-function; empty if it is unknown."""
    number, table = call.payload[0], call.table
    if number == Service.SESSION_CONTROL:
        session = table.sessions.get(call.sub_function)
        return session.from_sessions if session is not None else ()
    if number == Service.SECURITY_ACCESS:
        level = table.levels.get(call.sub_function - (call.sub_function % 2 == 0))
        return level.sessions if level is not None else ()
    return table.services[number].sessions if call.sub_function in _SUB_FUNCTIONS[number] else ()


def _replied(request: Request, response: bytes | Nrc, state: ServerState) -> Reply:
    """Return the reply; a suppressed positive response, or a refusal of a functional request, is withheld."""
    if isinstance(response, Nrc):
        sent, is_kept_back = _negative(request, response), request.is_functional and response in SILENT_WHEN_FUNCTIONAL
    else:
        sent, payload = response, request.payload
        is_kept_back = len(payload) > 1 and _has_sub_function(payload[0]) and bool(payload[1] & SUPPRESS)
    return Reply(payload=None, state=state, withheld=sent) if is_kept_back else Reply(payload=sent, state=state)


def _negative(request: Request, nrc: Nrc) -> bytes:
    return bytes([NEGATIVE, request.payload[0], nrc])
