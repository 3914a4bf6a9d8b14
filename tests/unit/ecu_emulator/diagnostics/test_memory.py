"""A trouble code's life: pending, confirmed, lamp on, healed, aged; annex D of ISO 14229-1."""

import pytest

from ecu_emulator.diagnostics.descriptions import Trouble
from ecu_emulator.diagnostics.iso14229 import Status
from ecu_emulator.diagnostics.memory import (
    Capture,
    TestResult,
    TroubleMemory,
    begin_cycle,
    clear,
    empty_memory,
    is_lamp_on,
    note_warm_up,
    report,
)
from tests.unit.ecu_emulator.diagnostics.bench import Bench

SLIP = Trouble(
    code="P0811", failure_type=0, text="", severity=0x40, lights_lamp=True, confirm_cycles=2, failed_step=50,
    passed_step=64,
)  # fmt: skip
HOT = Trouble(code="P2787", failure_type=0x4B, text="", severity=0x80, lights_lamp=True)
FLUID = Trouble(code="P0897", failure_type=0, text="", severity=0x20, lights_lamp=False)
TROUBLES = {trouble.number: trouble for trouble in (SLIP, HOT, FLUID)}


class Car:
    """A memory that is driven."""

    def __init__(self, trouble: Trouble) -> None:
        self.trouble = trouble
        self.memory: TroubleMemory = begin_cycle(empty_memory(TROUBLES), TROUBLES)

    def test(self, result: TestResult, mark: int = 0) -> None:
        self.memory = report(self.memory, self.trouble, result, Capture(snapshot=((0x0100, bytes([mark])),)))

    def drive(self, *results: TestResult, is_warm: bool = True) -> None:
        """Drive one operation cycle and begin the next."""
        for result in results:
            self.test(result)
        if is_warm:
            self.memory = note_warm_up(self.memory)
        self.memory = begin_cycle(self.memory, TROUBLES)

    @property
    def status(self) -> int:
        return int(self.memory.records[self.trouble.number].status)

    @property
    def counter(self) -> int:
        return self.memory.records[self.trouble.number].detection_counter


@pytest.mark.parametrize(
    ("code", "failure_type", "number"),
    [("P0811", 0x07, 0x081107), ("C1234", 0x00, 0x523400), ("B3FFF", 0xFF, 0xBFFFFF), ("U0100", 0x87, 0xC10087)],
)
def test_a_code_is_three_bytes(code: str, failure_type: int, number: int) -> None:
    assert Trouble(code=code, failure_type=failure_type, text="", severity=0, lights_lamp=False).number == number


def test_a_new_code_was_never_tested() -> None:
    assert Car(SLIP).status == 0x50


def test_a_test_that_passes_clears_what_was_not_complete() -> None:
    car = Car(SLIP)
    car.test(TestResult.PASSED)
    assert car.status == 0x00


def test_a_failure_is_pending_and_confirmed_in_the_second_cycle() -> None:
    car = Car(SLIP)
    car.test(TestResult.FAILED)
    assert car.status == 0x27
    car.test(TestResult.FAILED)
    assert car.status == 0x27  # the same cycle
    car.test(TestResult.PASSED)
    assert car.status == 0x26
    car.drive()
    assert car.status == 0x64
    car.test(TestResult.FAILED)
    assert car.status == 0xAF
    assert is_lamp_on(car.memory)


def test_a_code_that_needs_one_failure_is_confirmed_at_once() -> None:
    car = Car(HOT)
    car.test(TestResult.FAILED)
    assert car.status == 0xAF


def test_pending_stays_until_a_whole_cycle_has_passed() -> None:
    car = Car(SLIP)
    car.drive(TestResult.FAILED)
    car.drive()  # nothing was tested
    assert car.status & Status.PENDING
    car.test(TestResult.PASSED)
    assert car.status & Status.PENDING  # the cycle goes on
    car.drive()
    assert not car.status & Status.PENDING
    car.test(TestResult.FAILED)
    assert not car.status & Status.CONFIRMED  # the failure before is forgotten


def test_the_lamp_goes_out_after_three_good_cycles_and_the_code_after_forty_more() -> None:
    car = Car(HOT)
    car.drive(TestResult.FAILED)
    for _ in range(3):
        car.test(TestResult.PASSED)
        assert car.status & Status.WARNING_REQUESTED
        car.drive(TestResult.PASSED)
    assert car.status == 0x68
    assert not is_lamp_on(car.memory)
    for _ in range(39):
        car.drive(TestResult.PASSED)
    assert car.status & Status.CONFIRMED
    car.drive(TestResult.PASSED, is_warm=False)
    car.drive(is_warm=True)  # not tested
    assert car.status & Status.CONFIRMED
    car.drive(TestResult.PASSED)
    assert car.status == 0x60  # failed since the last clear: ageing does not forget that
    assert not car.memory.records[HOT.number].has_data


def test_a_failure_begins_ageing_anew() -> None:
    car = Car(FLUID)
    car.drive(TestResult.FAILED)
    for _ in range(39):
        car.drive(TestResult.PASSED)
    car.drive(TestResult.FAILED)
    for _ in range(39):
        car.drive(TestResult.PASSED)
    assert car.status & Status.CONFIRMED
    car.drive(TestResult.PASSED)
    assert not car.status & Status.CONFIRMED


def test_samples_move_the_counter_in_steps_and_it_turns_at_zero() -> None:
    car = Car(SLIP)
    car.test(TestResult.PREPASSED)
    assert car.counter == -64
    car.test(TestResult.PREFAILED)
    assert (car.counter, car.status) == (50, 0x50)
    car.test(TestResult.PREFAILED)
    assert car.counter == 100
    car.test(TestResult.PREFAILED)
    assert (car.counter, car.status) == (127, 0x27)
    car.test(TestResult.PREPASSED)
    assert (car.counter, car.status) == (-64, 0x27)  # still the last whole result
    car.test(TestResult.PREPASSED)
    assert (car.counter, car.status) == (-128, 0x26)
    car.drive()
    assert car.counter == 0


def test_clearing_forgets_one_code_or_all() -> None:
    memory = empty_memory(TROUBLES)
    for trouble in TROUBLES.values():
        memory = report(memory, trouble, TestResult.FAILED, Capture())
    one = clear(memory, HOT.number)
    assert [int(one.records[number].status) for number in TROUBLES] == [0x27, 0x50, 0x2F]
    assert [int(record.status) for record in clear(memory, 0xFFFFFF).records.values()] == [0x50] * 3


def test_the_first_and_the_latest_failure_are_kept() -> None:
    car = Car(HOT)
    for mark in (1, 2, 3):
        car.test(TestResult.FAILED, mark)
        car.test(TestResult.FAILED, 99)  # the same failure goes on
        car.test(TestResult.PASSED)
    record = car.memory.records[HOT.number]
    assert (record.first, record.latest, record.occurrences) == (
        Capture(snapshot=((0x0100, b"\1"),)),
        Capture(snapshot=((0x0100, b"\3"),)),
        3,
    )


def test_a_tester_reads_what_was_kept() -> None:
    bench = Bench()
    bench.values |= {"odometer_m": 12_345.0, "shift_count": 7.0}
    bench.monitor("P0811", TestResult.PREFAILED)
    assert bench.ask("19 14") == "59 14 08 11 07 10"
    bench.monitor("P0811", TestResult.FAILED)
    assert bench.ask("19 14") == "59 14"
    assert bench.ask("19 03") == "59 03 08 11 07 01 08 11 07 02"
    assert bench.ask("19 06 08 11 07 10") == "59 06 08 11 07 27 10 00 00 30 39 00 00 00 07"
    assert bench.ask("19 06 08 11 07 01") == "59 06 08 11 07 27 01 01"
    snapshot = bench.ask("19 04 08 11 07 01")
    assert snapshot.startswith("59 04 08 11 07 27 01 0b 01 00 ff ff ff ff 01 01 00 00 30 39")
    both = bench.ask("19 04 08 11 07 ff")
    assert len(both) == 2 * len(snapshot) - len("59 04 08 11 07 27")
    assert bench.ask("14 08 11 07") == "54"
    assert bench.ask("19 04 08 11 07 ff") == "59 04 08 11 07 50"
