"""Sessions, security, communication, reset and routines: services 10, 11, 27, 28, 31, 3E and 85."""

from dataclasses import replace
from typing import Final

from workshop.controller.descriptions import Routine, SecurityLevel, are_valid, encode, size_of
from workshop.controller.iso14229 import DEFAULT_SESSION, Nrc
from workshop.controller.memory import after_cycle, begin_cycle
from workshop.controller.state import (
    Call,
    Communication,
    Instant,
    KeptState,
    Result,
    RoutineRun,
    ServerState,
    ServiceOutcome,
    is_in_session,
    is_unlocked,
    locked,
    unmet,
    unmet_by_service,
)
from workshop.controller.table import DiagnosticTable

HARD_RESET: Final = 0x01
KEY_OFF_ON_RESET: Final = 0x02
SOFT_RESET: Final = 0x03
CODES_ON: Final = 0x01
CODES_OFF: Final = 0x02
ALL_ON: Final = 0x00
_MS_PER_S: Final = 1e3
_P2_STAR_STEP_S: Final = 0.01
_ALL_GROUPS: Final = b"\xff\xff\xff"
_NORMAL: Final = 0x01  # bits of the communication type
_MANAGEMENT: Final = 0x02
_RESERVED: Final = 0x0C
_OF_SESSION: Final = ("session", "holder", "heard_s", "unlocked", "seed_level", "seed")


def session_control(call: Call) -> Result:
    """Enter a session: response with P2 in milliseconds and P2* in steps of ten."""
    if len(call.payload) != 2:
        return Nrc.INCORRECT_LENGTH
    if refusal := unmet_by_service(call):
        return refusal
    if call.is_guest and call.sub_function != DEFAULT_SESSION:
        return Nrc.BUSY_REPEAT_REQUEST  # there is one session, and another client holds it
    timing = call.table.timing
    p2 = round(timing.p2_s * _MS_PER_S).to_bytes(2, "big")
    p2_star = round(timing.p2_star_s / _P2_STAR_STEP_S).to_bytes(2, "big")
    if call.is_guest:
        return call.echoed(p2 + p2_star)
    state = replace(in_session(call.state, call.sub_function), holder=call.request.client)
    return call.echoed(p2 + p2_star, state)


def in_session(state: ServerState, session: int) -> ServerState:
    """Return the state in a session, with security locked; the default session also ends all else of the last one."""
    state = replace(locked(state), session=session)
    if session != DEFAULT_SESSION:
        return state
    routines = {
        number: replace(run, is_running=False, was_stopped=True) if run.is_running else run
        for number, run in state.routines.items()
    }
    return replace(
        state,
        communication=Communication(),
        are_codes_updated=True,
        routines=routines,
        waiting=None,
    )


def as_guest(state: ServerState) -> ServerState:
    """Return the state for a client while another one holds a session: default session, security locked."""
    return replace(locked(state), session=DEFAULT_SESSION)


def after_guest(before: ServerState, after: ServerState) -> ServerState:
    """Return the state after a guest's request: session and security are as before, unless the guest reset."""
    if after.asleep_until_s != before.asleep_until_s:
        return after
    return replace(after, **{name: getattr(before, name) for name in _OF_SESSION})


def ecu_reset(call: Call) -> Result:
    """Answer, then start anew."""
    if len(call.payload) != 2:
        return Nrc.INCORRECT_LENGTH
    if refusal := unmet_by_service(call):
        return refusal
    state = started(call.state, call.table, call.moment.t_s, is_new_cycle=call.sub_function != SOFT_RESET)
    return call.echoed(state=replace(state, asleep_until_s=call.moment.t_s + call.table.timing.reset_s))


def started(state: KeptState, table: DiagnosticTable, t_s: float, *, is_new_cycle: bool = True) -> ServerState:
    """Return the state at a start, with the saved codes, written data and counts of wrong keys."""
    until_s = {
        number: t_s + level.delay_s
        for number, level in table.levels.items()
        if state.wrong_keys.get(number, 0) >= level.most_attempts
    }
    members = state.members
    if is_new_cycle:
        memory = begin_cycle(state.memory, table.troubles)
        members |= {"memory": memory, "emissions": after_cycle(state.emissions, state.memory, memory)}
    return ServerState(**members, locked_until_s=until_s, heard_s=t_s)


def tester_present(call: Call) -> Result:
    """Respond; any request restarts S3."""
    return Nrc.INCORRECT_LENGTH if len(call.payload) != 2 else call.echoed()


def control_code_setting(call: Call) -> Result:
    """Switch the updating of trouble codes on or off; the option, if there is one, must name all groups."""
    option = call.payload[2:]
    if len(option) not in {0, len(_ALL_GROUPS)}:
        return Nrc.INCORRECT_LENGTH
    if option not in {b"", _ALL_GROUPS}:
        return Nrc.REQUEST_OUT_OF_RANGE
    if call.sub_function != CODES_ON and (refusal := unmet_by_service(call)):  # back to normal is always possible
        return refusal
    return call.echoed(state=replace(call.state, are_codes_updated=call.sub_function == CODES_ON))


def communication_control(call: Call) -> Result:
    """Switch messages on or off: sub-function 0 both directions on, 1 receive only, 2 send only, 3 both off.

    The lower half of the communication type selects messages, the upper half the network: all (0) or that of the
    request (F).
    """
    if len(call.payload) != 3:
        return Nrc.INCORRECT_LENGTH
    kind, network = call.payload[2], call.payload[2] >> 4
    if kind & _RESERVED or not kind & (_NORMAL | _MANAGEMENT) or network not in {0x0, 0xF}:
        return Nrc.REQUEST_OUT_OF_RANGE
    if call.sub_function != ALL_ON and (refusal := unmet_by_service(call)):  # back to normal is always possible
        return refusal
    receives, sends = call.sub_function in {0x00, 0x01}, call.sub_function in {0x00, 0x02}
    communication = call.state.communication
    if kind & _NORMAL:
        communication = replace(communication, sends_normal=sends, receives_normal=receives)
    return call.echoed(state=replace(call.state, communication=communication))


def security_access(call: Call) -> Result:
    """Send a seed (odd sub-function) or check a key (the next even one)."""
    is_seed_wanted = call.sub_function % 2 == 1
    level = call.table.levels[call.sub_function if is_seed_wanted else call.sub_function - 1]
    return _send_seed(call, level) if is_seed_wanted else _check_key(call, level)


def key_of(level: SecurityLevel, seed: bytes) -> bytes:
    return (int.from_bytes(seed, "big") ^ level.key_mask).to_bytes(level.seed_bytes, "big")


def delay_over(state: ServerState, level: SecurityLevel, t_s: float) -> ServerState:
    """Return the state after a delay: one more key may be tried."""
    until_s = state.locked_until_s.get(level.number)
    if until_s is None or t_s < until_s:
        return state
    return replace(
        state,
        locked_until_s={number: time for number, time in state.locked_until_s.items() if number != level.number},
        wrong_keys={**state.wrong_keys, level.number: level.most_attempts - 1},
    )


def _send_seed(call: Call, level: SecurityLevel) -> Result:
    if len(call.payload) != 2:
        return Nrc.INCORRECT_LENGTH
    if call.state.unlocked == level.number:
        return call.echoed(bytes(level.seed_bytes))
    if level.number in call.state.locked_until_s:
        return Nrc.TIME_DELAY_NOT_EXPIRED
    seed = call.moment.chance[: level.seed_bytes].ljust(level.seed_bytes, b"\x5a")
    if not any(seed):
        seed = bytes(level.seed_bytes - 1) + b"\1"  # zeros say that it is unlocked
    return call.echoed(seed, replace(call.state, seed_level=level.number, seed=seed))


def _check_key(call: Call, level: SecurityLevel) -> Result:
    if len(call.payload) != 2 + level.seed_bytes:
        return Nrc.INCORRECT_LENGTH
    if call.state.seed_level != level.number:
        return Nrc.REQUEST_SEQUENCE_ERROR
    state = replace(call.state, seed_level=0, seed=b"")
    if call.payload[2:] == key_of(level, call.state.seed):
        others = {number: count for number, count in state.wrong_keys.items() if number != level.number}
        return call.echoed(state=replace(state, unlocked=level.number, wrong_keys=others))
    count = state.wrong_keys.get(level.number, 0) + 1
    state = replace(state, wrong_keys={**state.wrong_keys, level.number: count})
    if count < level.most_attempts:
        return ServiceOutcome(response=Nrc.INVALID_KEY, state=state)
    until_s = {**state.locked_until_s, level.number: call.moment.t_s + level.delay_s}
    return ServiceOutcome(response=Nrc.EXCEEDED_NUMBER_OF_ATTEMPTS, state=replace(state, locked_until_s=until_s))


START: Final = 0x01
STOP: Final = 0x02
RESULTS: Final = 0x03
COMPLETED: Final = 0x00  # first byte of the routine's status
RUNNING: Final = 0x01
STOPPED: Final = 0x02


def routine_control(call: Call) -> Result:
    """Start a routine, stop it, or read its results."""
    routine = _routine(call)
    if isinstance(routine, Nrc):
        return routine
    run = call.state.routines.get(routine.number)
    is_running = run is not None and run.is_running
    if call.sub_function == START:
        return Nrc.REQUEST_SEQUENCE_ERROR if is_running else _start(call, routine, call.payload[4:])
    if run is None or (call.sub_function == STOP and not is_running):
        return Nrc.REQUEST_SEQUENCE_ERROR
    if call.sub_function == RESULTS:
        return routine_response(call, routine, run)
    stopped = replace(run, is_running=False, was_stopped=True)
    return routine_response(call, routine, stopped, _with_run(call.state, routine.number, stopped))


def _routine(call: Call) -> Routine | Nrc:
    """Return the routine of a request, or why the request is refused."""
    if len(call.payload) < 4:
        return Nrc.INCORRECT_LENGTH
    routine = call.table.routines.get(int.from_bytes(call.payload[2:4], "big"))
    if routine is None or not is_in_session(call, routine.access):
        return Nrc.REQUEST_OUT_OF_RANGE
    if not is_unlocked(call.state, routine.access.levels):
        return Nrc.SECURITY_ACCESS_DENIED
    if call.sub_function == STOP and not routine.can_be_stopped:
        return Nrc.SUB_FUNCTION_NOT_SUPPORTED
    if len(call.payload) != 4 + (size_of(routine.options) if call.sub_function == START else 0):
        return Nrc.INCORRECT_LENGTH
    return routine


def _start(call: Call, routine: Routine, options: bytes) -> Result:
    if not are_valid(routine.options, options):
        return Nrc.REQUEST_OUT_OF_RANGE
    if refusal := unmet_by_service(call) or unmet(call, routine.access.conditions):
        return refusal
    run = RoutineRun(ends_s=call.moment.t_s + routine.duration_s, options=options)
    state = _with_run(call.state, routine.number, run)
    if routine.is_awaited:
        return ServiceOutcome(response=b"", state=state, is_final=False)
    return routine_response(call, routine, run, state)


def routine_response(call: Call, routine: Routine, run: RoutineRun, state: ServerState | None = None) -> ServiceOutcome:
    """Return the positive response of a routine: number, status, and results once it has ended."""
    how_far = RUNNING if run.is_running else STOPPED if run.was_stopped else COMPLETED
    return call.echoed(routine.number.to_bytes(2, "big") + bytes([how_far]) + run.results, state)


def finished(state: ServerState, table: DiagnosticTable, number: int, moment: Instant) -> ServerState:
    """Return the state after the vehicle has completed a routine; the results are the present values."""
    run = state.routines.get(number)
    if run is None or not run.is_running:
        return state
    results = encode(table.routines[number].results, moment.values)
    return _with_run(state, number, replace(run, is_running=False, results=results))


def failed(state: ServerState, number: int, nrc: int = Nrc.PROGRAMMING_FAILURE) -> ServerState:
    """Return the state after the vehicle could not complete a routine, with the response code."""
    run = state.routines.get(number)
    if run is None or not run.is_running:
        return state
    return _with_run(state, number, replace(run, is_running=False, was_stopped=True, failed_nrc=nrc))


def timed_out(state: ServerState, table: DiagnosticTable, moment: Instant) -> ServerState:
    """Return the state with expired routines ended, or stopped where the vehicle should have ended them."""
    for number, run in state.routines.items():
        if not run.is_running or moment.t_s < run.ends_s:
            continue
        if table.routines[number].ends_by_itself:
            state = finished(state, table, number, moment)
        else:
            state = _with_run(state, number, replace(run, is_running=False, was_stopped=True))
    return state


def _with_run(state: ServerState, number: int, run: RoutineRun) -> ServerState:
    return replace(state, routines={**state.routines, number: run})
