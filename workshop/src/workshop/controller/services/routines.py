"""Service 31: routines are started, stopped and asked for their results."""

from dataclasses import replace
from typing import Final

from workshop.controller.descriptions import Routine, are_valid, encode, size_of
from workshop.controller.iso14229 import Nrc
from workshop.controller.state import (
    Call,
    Instant,
    Outcome,
    Result,
    RoutineRun,
    ServerState,
    is_in_session,
    is_unlocked,
    unmet,
    unmet_by_service,
)
from workshop.controller.table import DiagnosticTable

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
        return answered(call, routine, run)
    stopped = replace(run, is_running=False, was_stopped=True)
    return answered(call, routine, stopped, _with(call.state, routine.number, stopped))


def _routine(call: Call) -> Routine | Nrc:
    """Return the routine that a request is about, if this may be asked of it."""
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
    state = _with(call.state, routine.number, run)
    if routine.is_awaited:
        return Outcome(response=b"", state=state, is_final=False)
    return answered(call, routine, run, state)


def answered(call: Call, routine: Routine, run: RoutineRun, state: ServerState | None = None) -> Outcome:
    """Return the positive response about a routine: its number, how far it is, and what it found once it has ended."""
    how_far = RUNNING if run.is_running else STOPPED if run.was_stopped else COMPLETED
    return call.echoed(routine.number.to_bytes(2, "big") + bytes([how_far]) + run.results, state)


def finished(state: ServerState, table: DiagnosticTable, number: int, moment: Instant) -> ServerState:
    """Return the state after the vehicle has done what a routine asked for; its results are what is known now."""
    run = state.routines.get(number)
    if run is None or not run.is_running:
        return state
    results = encode(table.routines[number].results, moment.values)
    return _with(state, number, replace(run, is_running=False, results=results))


def failed(state: ServerState, number: int, nrc: int = Nrc.PROGRAMMING_FAILURE) -> ServerState:
    """Return the state after the vehicle could not do what a routine asked for, and why."""
    run = state.routines.get(number)
    if run is None or not run.is_running:
        return state
    return _with(state, number, replace(run, is_running=False, was_stopped=True, failed_nrc=nrc))


def timed_out(state: ServerState, table: DiagnosticTable, moment: Instant) -> ServerState:
    """Return the state after time has passed: a routine ends by itself, or is stopped if the vehicle did not end it."""
    for number, run in state.routines.items():
        if not run.is_running or moment.t_s < run.ends_s:
            continue
        if table.routines[number].ends_by_itself:
            state = finished(state, table, number, moment)
        else:
            state = _with(state, number, replace(run, is_running=False, was_stopped=True))
    return state


def _with(state: ServerState, number: int, run: RoutineRun) -> ServerState:
    return replace(state, routines={**state.routines, number: run})
