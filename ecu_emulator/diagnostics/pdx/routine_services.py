"""Service 31 for a tool: routines."""

from collections.abc import Iterator
from typing import Final

from ecu_emulator.diagnostics.codes import Service as Number
from ecu_emulator.diagnostics.descriptions import Routine
from ecu_emulator.diagnostics.pdx.dictionary import Dictionary
from ecu_emulator.diagnostics.pdx.parameters import Parameter, constant, sub_function
from ecu_emulator.diagnostics.pdx.service import Service, access_to
from ecu_emulator.diagnostics.services.routines import COMPLETED, RESULTS, RUNNING, START, STOP, STOPPED
from ecu_emulator.diagnostics.table import DiagnosticTable

_ACTIONS: Final = {START: "Start", STOP: "Stop", RESULTS: "Results of"}


def routine_services(table: DiagnosticTable, dictionary: Dictionary) -> Iterator[Service]:
    """Yield services to start each routine, to stop it if that can be done, and to read its results."""
    for routine in table.routines.values():
        options = dictionary.field_parameters(f"option of {routine.name}", routine.options)
        results = dictionary.field_parameters(f"result of {routine.name}", routine.results)
        for sub, name in _ACTIONS.items():
            if sub == STOP and not routine.can_be_stopped:
                continue
            number = constant("identifier", routine.number, 2, "ID")
            yield Service(
                name=f"{name} {routine.name}",
                number=Number.ROUTINE_CONTROL,
                semantic="ROUTINE",
                request=(sub_function(sub), number, *(options if sub == START else ())),
                responses=_responses(routine, sub, number, results),
                access=access_to(table, Number.ROUTINE_CONTROL, routine.access),
            )


def _responses(
    routine: Routine, sub: int, number: Parameter, results: tuple[Parameter, ...]
) -> tuple[tuple[Parameter, ...], ...]:
    """Return what may be answered: the status says whether results follow."""
    states = {START: (RUNNING,), STOP: (STOPPED,), RESULTS: (COMPLETED, RUNNING, STOPPED)}[sub]
    if sub == START and routine.is_awaited:
        states = (COMPLETED, STOPPED)
    begin = sub_function(sub), number
    return tuple((*begin, constant("status", status), *(results if status == COMPLETED else ())) for status in states)
