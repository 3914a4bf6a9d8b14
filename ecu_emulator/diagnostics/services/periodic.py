"""Service 2A: data that are sent again and again, until the client stops them or its session ends.

After ISO 14229-3 each goes out in one frame of its own identifier, without transport layer: the lower byte of the data
identifier, then the data.
"""

from dataclasses import replace
from typing import Final

from ecu_emulator.diagnostics.codes import Nrc, Service
from ecu_emulator.diagnostics.services.call import Call, Result, is_unlocked, unmet_by_service
from ecu_emulator.diagnostics.services.data import data_in, read_refusal, readable
from ecu_emulator.diagnostics.state import Moment, PeriodicRun, ServerState
from ecu_emulator.diagnostics.table import PERIODIC_PAGE, DiagnosticTable

SLOW: Final = 0x01
MEDIUM: Final = 0x02
FAST: Final = 0x03
STOP: Final = 0x04


def read_periodically(call: Call) -> Result:
    """Begin to send data at a rate, or stop some or all; those that are not there are left out, unless none is."""
    if len(call.payload) < 2 or (len(call.payload) == 2 and call.payload[1] != STOP):
        return Nrc.INCORRECT_LENGTH
    mode, names = call.payload[1], call.payload[2:]
    if mode not in {SLOW, MEDIUM, FAST, STOP}:
        return Nrc.REQUEST_OUT_OF_RANGE
    numbers = [number for name in names if _can_be_sent(call.table, call.state, number := PERIODIC_PAGE << 8 | name)]
    if names and not numbers:
        return Nrc.REQUEST_OUT_OF_RANGE
    if mode == STOP:
        left = {number: run for number, run in call.state.periodic.items() if names and number not in numbers}
        return call.positive(state=replace(call.state, periodic=left))
    return _begun(call, numbers, mode)


def _begun(call: Call, numbers: list[int], mode: int) -> Result:
    periodic = call.table.periodic
    if periodic is None:
        return Nrc.SERVICE_NOT_SUPPORTED
    pieces = [piece for number in numbers for piece in readable(call.table, call.state, number)]
    if refusal := read_refusal(call, pieces):
        return refusal
    period_s = {SLOW: periodic.slow_s, MEDIUM: periodic.medium_s, FAST: periodic.fast_s}[mode]
    runs = {**call.state.periodic, **dict.fromkeys(numbers, PeriodicRun(period_s=period_s, due_s=call.moment.t_s))}
    if len(runs) > periodic.most:
        return Nrc.REQUEST_OUT_OF_RANGE
    return unmet_by_service(call) or call.positive(state=replace(call.state, periodic=runs))


def only_allowed(state: ServerState, table: DiagnosticTable) -> ServerState:
    """Return the state without the sending of what may not be read any more, or was redefined too long."""
    if not state.periodic:
        return state
    is_there = state.session in table.services[Service.READ_PERIODICALLY].sessions
    left = {number: run for number, run in state.periodic.items() if is_there and _may_go_on(table, state, number)}
    return state if len(left) == len(state.periodic) else replace(state, periodic=left)


def due(table: DiagnosticTable, state: ServerState, moment: Moment) -> tuple[tuple[bytes, ...], ServerState]:
    """Return the messages that are due, and the state after them; what was missed is not made up for."""
    messages, runs = list[bytes](), dict[int, PeriodicRun]()
    for number, run in state.periodic.items():
        runs[number] = run
        if moment.t_s < run.due_s:
            continue
        data = data_in(table, state, moment, readable(table, state, number))
        messages.append(bytes([number & 0xFF]) + data)
        next_s = run.due_s + run.period_s
        runs[number] = replace(run, due_s=next_s if next_s > moment.t_s else moment.t_s + run.period_s)
    return tuple(messages), replace(state, periodic=runs) if messages else state


def _can_be_sent(table: DiagnosticTable, state: ServerState, number: int) -> bool:
    size_bytes = sum(piece.size_bytes for piece in readable(table, state, number))
    return 0 < size_bytes <= table.most_periodic_bytes


def _may_go_on(table: DiagnosticTable, state: ServerState, number: int) -> bool:
    pieces = readable(table, state, number)
    is_open = all(is_unlocked(state, table.data[piece.source].read.levels) for piece in pieces)
    return is_open and _can_be_sent(table, state, number)
