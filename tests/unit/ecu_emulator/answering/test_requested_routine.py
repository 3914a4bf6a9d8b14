"""A routine that the car performs: when it begins, when it is over, how long its judgement is waited for."""

from ecu_emulator.answering.requested_tasks import ESTIMATE_S, Driven, RequestedRoutine
from ecu_emulator.diagnostics.clutches import OnBoardFriction
from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.table_file import shipped_table
from ecu_emulator.scenario.scenario import Routine
from tests.unit.ecu_emulator.diagnostics.bench import PARKED

REVS = 0x0301
THROUGH = Driven(shift_count=12, gear=1.0, last_shift_ns=50_000_000_000)


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

    def step(self, driven: Driven, t_s: float, *, is_live: bool = True, end_ns: int = 0) -> None:
        estimates = {1: OnBoardFriction(end_ns=end_ns)} if end_ns else {}
        self.routine.step(driven, estimates, t_s, is_live=is_live)


def test_the_car_is_asked_once_for_as_many_revs_as_the_tester_wants() -> None:
    shop = Workshop()
    for t_s in (0.0, 0.1, 0.2):
        shop.step(Driven(shift_count=2, gear=1.0), t_s)
    assert shop.car.asked == [Routine(open_revs=3, closed_revs=4)]
    assert shop.is_running


def test_it_ends_once_the_last_shift_is_judged() -> None:
    shop = Workshop()
    shop.step(Driven(shift_count=2, gear=1.0), 0.0)
    shop.step(Driven(shift_count=7, gear=6.0, last_shift_ns=30_000_000_000), 30.0, end_ns=30_000_000_000)
    shop.step(THROUGH, 50.0, end_ns=47_000_000_000)  # of the shift before
    assert shop.is_running
    shop.step(THROUGH, 50.1, end_ns=49_990_000_000)
    assert not shop.is_running
    shop.step(THROUGH, 50.2, end_ns=49_990_000_000)
    assert len(shop.car.asked) == 1


def test_a_judgement_that_does_not_come_is_not_waited_for_without_end() -> None:
    shop = Workshop()
    shop.step(Driven(shift_count=2), 0.0)
    shop.step(THROUGH, 50.0)
    shop.step(THROUGH, 50.0 + ESTIMATE_S - 0.1)
    assert shop.is_running
    shop.step(THROUGH, 50.0 + ESTIMATE_S)
    assert not shop.is_running


def test_nobody_waits_for_an_estimate_that_does_not_change() -> None:
    shop = Workshop()
    shop.step(Driven(shift_count=2), 0.0, is_live=False)
    shop.step(THROUGH, 50.0, is_live=False)
    assert not shop.is_running


def test_what_was_broken_off_can_be_begun_again() -> None:
    shop = Workshop()
    shop.step(Driven(), 0.0)
    shop.controller.leave(0)  # the tester goes, and with it the session
    shop.step(Driven(), 0.1)
    for request in ("10 03", "27 01", "27 02 5a a5 c3 3d", "31 01 03 01 01 01"):
        shop.controller.ask(bytes.fromhex(request))
    shop.step(Driven(), 0.2)
    assert shop.car.asked == [Routine(open_revs=3, closed_revs=4), Routine(open_revs=1, closed_revs=1)]
