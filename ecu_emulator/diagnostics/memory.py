"""The memory of trouble codes: status bits, fault detection counters, healing and ageing, after ISO 14229-1 annex D.

Every function returns a new memory. What the vehicle was like at a failure is handed in by the caller, as bytes.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

from ecu_emulator.diagnostics.codes import ALL_CODES, CLEARED, Status
from ecu_emulator.diagnostics.descriptions import Trouble

MOST_COUNT: Final = 0xFF  # counters stay there
FAILED_COUNTER: Final = 127
PASSED_COUNTER: Final = -128
FIRST_RECORD: Final = 1  # number of the snapshot of the first failure
LATEST_RECORD: Final = 2


class TestResult(StrEnum):
    """What a monitor says: a test that has ended, or one sample on the way to it."""

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
    """What is known of one trouble code."""

    status: Status = CLEARED
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
    """The trouble codes of a controller, by number, and the operation cycle that they are in."""

    records: Mapping[int, TroubleRecord]
    is_warmed_up: bool = False  # the vehicle, in this operation cycle
    has_begun: bool = False  # an operation cycle, ever


def empty_memory(numbers: Iterable[int]) -> TroubleMemory:
    """Return the memory of a new controller."""
    return TroubleMemory(records={number: TroubleRecord() for number in numbers})


def begin_cycle(memory: TroubleMemory, troubles: Mapping[int, Trouble]) -> TroubleMemory:
    """Return the memory after one operation cycle has ended, however it did, and the next one has begun."""
    if not memory.has_begun:
        return replace(memory, has_begun=True)
    records = {
        number: _cycled(record, troubles[number], is_warmed_up=memory.is_warmed_up)
        for number, record in memory.records.items()
    }
    return replace(memory, records=records, is_warmed_up=False)


def note_warm_up(memory: TroubleMemory) -> TroubleMemory:
    """Return the memory in a cycle in which the vehicle has become warm: only such cycles count for ageing."""
    return memory if memory.is_warmed_up else replace(memory, is_warmed_up=True)


def needs_capture(memory: TroubleMemory, trouble: Trouble, result: TestResult) -> bool:
    """Return whether a result makes a failure of which the vehicle's values are kept; ``report`` asks for them then."""
    record = memory.records[trouble.number]
    is_failure = _counted(record.detection_counter, trouble, result) == FAILED_COUNTER
    return is_failure and (not record.status & Status.TEST_FAILED or None in (record.first, record.latest))


def report(memory: TroubleMemory, trouble: Trouble, result: TestResult, capture: Capture) -> TroubleMemory:
    """Return the memory after a monitor has spoken.

    Parameters
    ----------
    memory, trouble
        The memory and the code that is tested.
    result
        A whole test, or a sample that moves the fault detection counter; at 127 the test has failed, at -128 passed.
    capture
        The vehicle at this moment; kept if the test fails that did not before.
    """
    record = memory.records[trouble.number]
    counter = _counted(record.detection_counter, trouble, result)
    record = replace(record, detection_counter=counter)
    if counter == FAILED_COUNTER:
        record = _failed(record, trouble, capture)
    elif counter == PASSED_COUNTER:
        left = Status.TEST_FAILED | Status.NOT_TESTED_SINCE_CLEAR | Status.NOT_TESTED_THIS_CYCLE
        record = replace(record, status=record.status & ~left)
    if record == memory.records[trouble.number]:
        return memory
    return replace(memory, records={**memory.records, trouble.number: record})


def clear(memory: TroubleMemory, group: int) -> TroubleMemory:
    """Return the memory without what was known of one code, or of all."""
    cleared = {number: TroubleRecord() for number in memory.records if group in {number, ALL_CODES}}
    return replace(memory, records={**memory.records, **cleared})


def is_lamp_on(memory: TroubleMemory) -> bool:
    """Return whether any code asks for the warning lamp."""
    return any(record.status & Status.WARNING_REQUESTED for record in memory.records.values())


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
    was_failed = bool(record.status & Status.TEST_FAILED)
    is_first_in_cycle = not record.status & Status.FAILED_THIS_CYCLE
    failed_cycles = min(MOST_COUNT, record.failed_cycles + is_first_in_cycle)
    status = record.status & ~(Status.NOT_TESTED_SINCE_CLEAR | Status.NOT_TESTED_THIS_CYCLE)
    status |= Status.TEST_FAILED | Status.FAILED_THIS_CYCLE | Status.PENDING | Status.FAILED_SINCE_CLEAR
    if failed_cycles >= trouble.confirm_cycles:
        status |= Status.CONFIRMED
    if trouble.lights_lamp and status & Status.CONFIRMED:
        status |= Status.WARNING_REQUESTED
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
    """Return a record after its cycle: one in which the test ran and never failed is a step towards forgetting."""
    is_good = not record.status & (Status.FAILED_THIS_CYCLE | Status.NOT_TESTED_THIS_CYCLE)
    if is_good:
        record = _after_a_good_cycle(record, trouble, is_warmed_up=is_warmed_up)
    status = record.status & ~Status.FAILED_THIS_CYCLE | Status.NOT_TESTED_THIS_CYCLE
    return replace(record, status=status, detection_counter=0)


def _after_a_good_cycle(record: TroubleRecord, trouble: Trouble, *, is_warmed_up: bool) -> TroubleRecord:
    status, passed, aged = record.status & ~Status.PENDING, record.passed_cycles, record.aged_cycles
    if status & Status.WARNING_REQUESTED:
        passed += 1
        if passed >= trouble.heal_cycles:
            status &= ~Status.WARNING_REQUESTED
    elif status & Status.CONFIRMED and is_warmed_up:
        aged += 1
        if aged >= trouble.age_cycles:
            status &= ~Status.CONFIRMED
    if not status & Status.CONFIRMED:
        return TroubleRecord(status=status)  # nothing is kept of what is forgotten, or was never confirmed
    return replace(record, status=status, failed_cycles=0, passed_cycles=passed, aged_cycles=aged)
