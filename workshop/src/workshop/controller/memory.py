"""The memory of trouble codes, after ISO 14229-1 annex D, and what OBD keeps beside it.

Status bits, fault detection counters, healing and ageing; permanent codes, the freeze frame, counts since a clear.
Every function returns a new memory or record. The caller passes the data of a failure as bytes. Codes that light the
lamp belong to OBD.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

from workshop.controller.descriptions import Trouble
from workshop.controller.iso14229 import ALL_CODES, CLEARED, DtcStatus

MOST_COUNT: Final = 0xFF  # counters stay there
FAILED_COUNTER: Final = 127
PASSED_COUNTER: Final = -128
FIRST_RECORD: Final = 1  # number of the snapshot of the first failure
LATEST_RECORD: Final = 2


class TestResult(StrEnum):
    """The result of a monitor: a completed test, or one sample."""

    __test__ = False  # not for pytest

    FAILED = "failed"
    PASSED = "passed"
    PREFAILED = "prefailed"
    PREPASSED = "prepassed"


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """The vehicle at a moment of failure: data by identifier, extended records by number."""

    snapshot: tuple[tuple[int, bytes], ...] = ()
    extended: tuple[tuple[int, bytes], ...] = ()


NOTHING_CAPTURED: Final = Capture()


@dataclass(frozen=True, slots=True, kw_only=True)
class TroubleRecord:
    """The stored state of one trouble code."""

    status: DtcStatus = CLEARED
    detection_counter: int = 0  # -128..127; forgotten when an operation cycle begins
    occurrences: int = 0  # times that the test failed after it had not
    failed_cycles: int = 0  # with a failure, since the last cycle that only passed
    passed_cycles: int = 0  # towards healing
    aged_cycles: int = 0  # towards ageing
    first: Capture | None = None
    latest: Capture | None = None

    @property
    def has_data(self) -> bool:
        """Whether a failure is stored."""
        return self.latest is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class TroubleMemory:
    """The trouble codes of a controller, by number, and its operation cycle."""

    records: Mapping[int, TroubleRecord]
    is_warmed_up: bool = False  # in this operation cycle
    has_begun: bool = False  # whether there was any operation cycle


def empty_memory(numbers: Iterable[int]) -> TroubleMemory:
    return TroubleMemory(records={number: TroubleRecord() for number in numbers})


def begin_cycle(memory: TroubleMemory, troubles: Mapping[int, Trouble]) -> TroubleMemory:
    """Return the memory at the begin of the next operation cycle."""
    if not memory.has_begun:
        return replace(memory, has_begun=True)
    records = {
        number: _cycled(record, troubles[number], is_warmed_up=memory.is_warmed_up)
        for number, record in memory.records.items()
    }
    return replace(memory, records=records, is_warmed_up=False)


def note_warm_up(memory: TroubleMemory) -> TroubleMemory:
    """Return the memory with a warm-up cycle marked: only such cycles count for ageing."""
    return memory if memory.is_warmed_up else replace(memory, is_warmed_up=True)


def needs_capture(memory: TroubleMemory, trouble: Trouble, result: TestResult) -> bool:
    """Return whether a result is a failure for which ``report`` needs the data of the vehicle."""
    record = memory.records[trouble.number]
    is_failure = _counted(record.detection_counter, trouble, result) == FAILED_COUNTER
    return is_failure and (not record.status & DtcStatus.TEST_FAILED or None in (record.first, record.latest))


def report(memory: TroubleMemory, trouble: Trouble, result: TestResult, capture: Capture) -> TroubleMemory:
    """Return the memory after a result of a monitor.

    Parameters
    ----------
    memory, trouble
        The memory and the code that is tested.
    result
        A completed test, or a sample that moves the fault detection counter: 127 is failed, -128 passed.
    capture
        Present data of the vehicle; stored if the test fails now and had not failed before.
    """
    record = memory.records[trouble.number]
    counter = _counted(record.detection_counter, trouble, result)
    record = replace(record, detection_counter=counter)
    if counter == FAILED_COUNTER:
        record = _failed(record, trouble, capture)
    elif counter == PASSED_COUNTER:
        left = DtcStatus.TEST_FAILED | DtcStatus.NOT_TESTED_SINCE_CLEAR | DtcStatus.NOT_TESTED_THIS_CYCLE
        record = replace(record, status=record.status & ~left)
    if record == memory.records[trouble.number]:
        return memory
    return replace(memory, records={**memory.records, trouble.number: record})


def clear(memory: TroubleMemory, group: int) -> TroubleMemory:
    """Return the memory with one code, or all, cleared."""
    cleared = {number: TroubleRecord() for number in memory.records if group in {number, ALL_CODES}}
    return replace(memory, records={**memory.records, **cleared})


def is_lamp_on(memory: TroubleMemory) -> bool:
    """Return whether any code asks for the warning lamp."""
    return any(record.status & DtcStatus.WARNING_REQUESTED for record in memory.records.values())


def _counted(counter: int, trouble: Trouble, result: TestResult) -> int:
    match result:
        case TestResult.FAILED:
            return FAILED_COUNTER
        case TestResult.PASSED:
            return PASSED_COUNTER
        case TestResult.PREFAILED:
            return min(FAILED_COUNTER, max(0, counter) + trouble.failed_step)
        case TestResult.PREPASSED:
            return max(PASSED_COUNTER, min(0, counter) - trouble.passed_step)


def _failed(record: TroubleRecord, trouble: Trouble, capture: Capture) -> TroubleRecord:
    was_failed = bool(record.status & DtcStatus.TEST_FAILED)
    is_first_in_cycle = not record.status & DtcStatus.FAILED_THIS_CYCLE
    failed_cycles = min(MOST_COUNT, record.failed_cycles + is_first_in_cycle)
    status = record.status & ~(DtcStatus.NOT_TESTED_SINCE_CLEAR | DtcStatus.NOT_TESTED_THIS_CYCLE)
    status |= DtcStatus.TEST_FAILED | DtcStatus.FAILED_THIS_CYCLE | DtcStatus.PENDING | DtcStatus.FAILED_SINCE_CLEAR
    if failed_cycles >= trouble.confirm_cycles:
        status |= DtcStatus.CONFIRMED
    if trouble.lights_lamp and status & DtcStatus.CONFIRMED:
        status |= DtcStatus.WARNING_REQUESTED
    return replace(
        record,
        status=status,
        occurrences=min(MOST_COUNT, record.occurrences + (not was_failed)),
        failed_cycles=failed_cycles,
        passed_cycles=0,
        aged_cycles=0,
        first=record.first or capture,
        latest=record.latest if was_failed and record.latest is not None else capture,
    )


def _cycled(record: TroubleRecord, trouble: Trouble, *, is_warmed_up: bool) -> TroubleRecord:
    """Return a record after its operation cycle; one with passed tests only counts towards healing and ageing."""
    is_good = not record.status & (DtcStatus.FAILED_THIS_CYCLE | DtcStatus.NOT_TESTED_THIS_CYCLE)
    if is_good:
        record = _after_a_good_cycle(record, trouble, is_warmed_up=is_warmed_up)
    status = record.status & ~DtcStatus.FAILED_THIS_CYCLE | DtcStatus.NOT_TESTED_THIS_CYCLE
    return replace(record, status=status, detection_counter=0)


def _after_a_good_cycle(record: TroubleRecord, trouble: Trouble, *, is_warmed_up: bool) -> TroubleRecord:
    status, passed, aged = record.status & ~DtcStatus.PENDING, record.passed_cycles, record.aged_cycles
    if status & DtcStatus.WARNING_REQUESTED:
        passed += 1
        if passed >= trouble.heal_cycles:
            status &= ~DtcStatus.WARNING_REQUESTED
    elif status & DtcStatus.CONFIRMED and is_warmed_up:
        aged += 1
        if aged >= trouble.age_cycles:
            status &= ~DtcStatus.CONFIRMED
    if not status & DtcStatus.CONFIRMED:
        return TroubleRecord(status=status)  # aged or never confirmed: its data are dropped
    return replace(record, status=status, failed_cycles=0, passed_cycles=passed, aged_cycles=aged)


NOT_YET_M: Final = -1.0  # no odometer value has been read since the clear

FrozenPids = tuple[tuple[int, bytes], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class FreezeFrame:
    """PIDs at the first failure of an OBD code; it stays until that code is cleared or aged."""

    code: int
    pids: FrozenPids


@dataclass(frozen=True, slots=True, kw_only=True)
class Emissions:
    """The stored state of OBD."""

    permanent: frozenset[int] = frozenset()  # codes that only the controller itself removes
    frame: FreezeFrame | None = None
    warm_ups: int = 0  # since codes were cleared
    cleared_at_m: float | None = None  # odometer at the clear; None: never cleared; NOT_YET_M: unknown then and since
    lamp_at_m: float | None = None  # odometer when the lamp went on; None: the lamp is off, or it was unknown


def after_test(
    emissions: Emissions,
    trouble: Trouble,
    before: TroubleMemory,
    after: TroubleMemory,
    odometer_m: float | None,
    freeze: Callable[[], FrozenPids],
) -> Emissions:
    """Return the record after a result of a monitor; ``freeze`` is called only for a new freeze frame."""
    if not trouble.lights_lamp or before is after:
        return emissions
    record = after.records[trouble.number]
    if record.status & DtcStatus.WARNING_REQUESTED and trouble.number not in emissions.permanent:
        emissions = replace(emissions, permanent=emissions.permanent | {trouble.number})
    if record.has_data and emissions.frame is None:
        emissions = replace(emissions, frame=FreezeFrame(code=trouble.number, pids=freeze()))
    if is_lamp_on(after) and not is_lamp_on(before):
        emissions = replace(emissions, lamp_at_m=odometer_m)
    return emissions


def located(emissions: Emissions, memory: TroubleMemory, odometer_m: float | None) -> Emissions:
    """Return the record with the odometer filled in where it was unknown at a clear or when the lamp went on."""
    if odometer_m is None:
        return emissions
    if emissions.cleared_at_m == NOT_YET_M:
        emissions = replace(emissions, cleared_at_m=odometer_m)
    is_lamp_lost = emissions.lamp_at_m is None and is_lamp_on(memory)
    return replace(emissions, lamp_at_m=odometer_m) if is_lamp_lost else emissions


def after_warm_up(emissions: Emissions, before: TroubleMemory, after: TroubleMemory) -> Emissions:
    """Return the record with the warm-up counted, once per operation cycle."""
    if before.is_warmed_up or not after.is_warmed_up:
        return emissions
    return replace(emissions, warm_ups=min(MOST_COUNT, emissions.warm_ups + 1))


def after_cycle(emissions: Emissions, before: TroubleMemory, after: TroubleMemory) -> Emissions:
    """Return the record after an operation cycle, in which permanent codes may be removed.

    One is removed after a cycle in which its test ran and never failed, if its lamp is off: healed, or cleared.
    """
    unproven = DtcStatus.FAILED_THIS_CYCLE | DtcStatus.NOT_TESTED_THIS_CYCLE
    permanent = frozenset(
        number
        for number in emissions.permanent
        if before.records[number].status & unproven or after.records[number].status & DtcStatus.WARNING_REQUESTED
    )
    frame = emissions.frame
    is_forgotten = frame is not None and not after.records[frame.code].has_data
    return replace(
        emissions,
        permanent=permanent,
        frame=None if is_forgotten else frame,
        lamp_at_m=emissions.lamp_at_m if is_lamp_on(after) else None,
    )


def after_clear(emissions: Emissions, after: TroubleMemory, group: int, odometer_m: float | None) -> Emissions:
    """Return the record after a client has cleared codes; permanent codes stay."""
    is_whole = group == ALL_CODES
    frame = emissions.frame
    if frame is not None and not after.records[frame.code].has_data:
        frame = None
    return replace(
        emissions,
        frame=frame,
        warm_ups=0 if is_whole else emissions.warm_ups,
        cleared_at_m=(NOT_YET_M if odometer_m is None else odometer_m) if is_whole else emissions.cleared_at_m,
        lamp_at_m=emissions.lamp_at_m if is_lamp_on(after) else None,
    )


def emission_codes(troubles: Mapping[int, Trouble], memory: TroubleMemory, bits: int) -> list[int]:
    """Return the OBD codes with one of these status bits."""
    return [
        number for number, record in memory.records.items() if troubles[number].lights_lamp and record.status & bits
    ]
