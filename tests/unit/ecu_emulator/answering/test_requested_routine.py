"""A routine that the car performs: when it begins, and when it is over."""

from ecu_emulator.answering.requested_tasks import Driven, RequestedRoutine
from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.table_file import shipped_table
from ecu_emulator.scenario.scenario import Routine
from tests.unit.ecu_emulator.diagnostics.bench import PARKED

REVS = 0x0301
THROUGH = Driven(shift_count=12, gear=1.0)


class Car:
    """One that only remembers what it was asked for."""

    is_waiting = True

    def __init__(self) -> None:
        self.asked: list[Routine] = []

    def begin_routine(self, request: Routine) -> None:
        self.asked.append(request)


class Workshop:
    def __init__(self) -> None:
        self.car = Car()
        self.controller = Controller(shipped_table(), values=lambda: PARKED, clock=lambda: 0.0, chance=bytes)
        self.routine = RequestedRoutine(self.car, self.controller)
        for request in ("10 03", "27 01", "27 02 5a a5 c3 3d", "31 01 03 01 03 04"):  # of zeros the seed ends with 1
            self.controller.ask(bytes.fromhex(request))

    @property
    def is_running(self) -> bool:
        return self.controller.state.routines[REVS].is_running


def test_the_car_is_asked_once_for_as_many_revs_as_the_tester_wants() -> None:
    shop = Workshop()
    for _ in range(3):
        shop.routine.step(Driven(shift_count=2, gear=1.0))
    assert shop.car.asked == [Routine(open_revs=3, closed_revs=4)]
    assert shop.is_running


def test_it_ends_once_the_car_is_back_in_first_gear() -> None:
    shop = Workshop()
    shop.routine.step(Driven(shift_count=2, gear=1.0))
    shop.routine.step(Driven(shift_count=7, gear=6.0))
    assert shop.is_running
    shop.routine.step(THROUGH)
    assert not shop.is_running
    assert shop.controller.tick() == bytes.fromhex("71 01 03 01 00")
    shop.routine.step(THROUGH)
    assert len(shop.car.asked) == 1


def test_what_was_broken_off_can_be_begun_again() -> None:
    shop = Workshop()
    shop.routine.step(Driven())
    shop.controller.leave(0)  # the tester goes, and with it the session
    shop.routine.step(Driven())
    for request in ("10 03", "27 01", "27 02 5a a5 c3 3d", "31 01 03 01 01 01"):
        shop.controller.ask(bytes.fromhex(request))
    shop.routine.step(Driven())
    assert shop.car.asked == [Routine(open_revs=3, closed_revs=4), Routine(open_revs=1, closed_revs=1)]
