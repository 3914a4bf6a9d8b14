"""What OBD keeps beside the memory of trouble codes: permanent codes, the freeze frame, what happened since a clear.

A code belongs to OBD if it lights the lamp. Every function returns a new record.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from ecu_emulator.diagnostics.codes import ALL_CODES, Status
from ecu_emulator.diagnostics.descriptions import Trouble
from ecu_emulator.diagnostics.memory import MOST_COUNT, TroubleMemory, is_lamp_on

ALL_EMISSION_CODES: Final = 0xFFFF33  # the group of SAE J1979-2
MOST_CYCLES: Final = 0xFFFF  # counters of monitors' use stay there

FrozenPids = tuple[tuple[int, bytes], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class FreezeFrame:
    """The vehicle when the first code of OBD failed; it stays until that code is forgotten."""

    code: int
    pids: FrozenPids


@dataclass(frozen=True, slots=True, kw_only=True)
class Emissions:
    """What is kept for OBD."""

    permanent: frozenset[int] = frozenset()  # codes that only the controller itself takes back
    frame: FreezeFrame | None = None
    warm_ups: int = 0  # since codes were cleared
    cleared_at_m: float | None = None  # odometer
    lamp_at_m: float | None = None  # odometer when the lamp went on
    is_driven: bool = False  # this operation cycle was driven as one that counts for the use of monitors
    driven_cycles: int = 0  # such cycles; no client clears them, nor the next
    ran_cycles: Mapping[int, int] = field(default_factory=dict)  # in which a code's test has run


def after_test(
    emissions: Emissions,
    trouble: Trouble,
    before: TroubleMemory,
    after: TroubleMemory,
    odometer_m: float | None,
    freeze: Callable[[], FrozenPids],
) -> Emissions:
    """Return the record after a result of a monitor has changed the memory; ``freeze`` is asked only if it must be."""
    if not trouble.lights_lamp or before is after:
        return emissions
    record = after.records[trouble.number]
    if record.status & Status.WARNING_REQUESTED and trouble.number not in emissions.permanent:
        emissions = replace(emissions, permanent=emissions.permanent | {trouble.number})
    if record.has_data and emissions.frame is None:
        emissions = replace(emissions, frame=FreezeFrame(code=trouble.number, pids=freeze()))
    if is_lamp_on(after) and not is_lamp_on(before):
        emissions = replace(emissions, lamp_at_m=odometer_m)
    return emissions


def after_warm_up(emissions: Emissions, before: TroubleMemory, after: TroubleMemory) -> Emissions:
    """Return the record after the vehicle became warm, once in an operation cycle."""
    if before.is_warmed_up or not after.is_warmed_up:
        return emissions
    return replace(emissions, warm_ups=min(MOST_COUNT, emissions.warm_ups + 1))


def after_cycle(emissions: Emissions, before: TroubleMemory, after: TroubleMemory) -> Emissions:
    """Return the record after an operation cycle: a permanent code goes after a good one, if its lamp is out by then.

    That is so when it has healed, and, after a clear, as soon as its test has run in a cycle and never failed there.
    """
    unproven = Status.FAILED_THIS_CYCLE | Status.NOT_TESTED_THIS_CYCLE
    permanent = frozenset(
        number
        for number in emissions.permanent
        if before.records[number].status & unproven or after.records[number].status & Status.WARNING_REQUESTED
    )
    frame = emissions.frame
    is_forgotten = frame is not None and not after.records[frame.code].has_data
    ran = {number for number, one in before.records.items() if not one.status & Status.NOT_TESTED_THIS_CYCLE}
    counts = emissions.ran_cycles
    return replace(
        emissions,
        is_driven=False,
        driven_cycles=min(MOST_CYCLES, emissions.driven_cycles + emissions.is_driven),
        ran_cycles={**counts, **{number: min(MOST_CYCLES, counts.get(number, 0) + 1) for number in ran}},
        permanent=permanent,
        frame=None if is_forgotten else frame,
        lamp_at_m=emissions.lamp_at_m if is_lamp_on(after) else None,
    )


def after_clear(emissions: Emissions, after: TroubleMemory, group: int, odometer_m: float | None) -> Emissions:
    """Return the record after a client has cleared codes: what is permanent stays."""
    is_whole = group in {ALL_CODES, ALL_EMISSION_CODES}
    frame = emissions.frame
    if frame is not None and not after.records[frame.code].has_data:
        frame = None
    return replace(
        emissions,
        frame=frame,
        warm_ups=0 if is_whole else emissions.warm_ups,
        cleared_at_m=odometer_m if is_whole else emissions.cleared_at_m,
        lamp_at_m=emissions.lamp_at_m if is_lamp_on(after) else None,
    )


def emission_codes(troubles: Mapping[int, Trouble], memory: TroubleMemory, bits: int) -> list[int]:
    """Return the codes of OBD whose status has one of these bits."""
    return [
        number for number, record in memory.records.items() if troubles[number].lights_lamp and record.status & bits
    ]
