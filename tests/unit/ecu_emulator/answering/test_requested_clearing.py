"""Clearing what was adapted: what the tester hears, what the control works with, and what the memory keeps of it."""

import pytest

from ecu_emulator.answering.monitoring import Monitoring
from ecu_emulator.answering.requested_tasks import RequestedAdaptation, RequestedClearing
from ecu_emulator.diagnostics.clutches import Adaptation
from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.iso14229 import Status
from ecu_emulator.diagnostics.table_file import shipped_table
from ecu_emulator.errors import RecordError
from ecu_emulator.scenario.scenario import Routine
from ecu_emulator.shift_control.touch_points import PressureSteps, TouchPoint, nominal_touch_pressures_pa
from tests.unit.ecu_emulator.diagnostics.bench import PARKED

NOT_LEARNED = 0x081054
NOMINAL_PA = nominal_touch_pressures_pa("nominal")
POINTS = {clutch: TouchPoint(pressure_pa=1.4e5, std_pa=900.0) for clutch in (1, 2)}


class Car:
    """One that only remembers by which touch points it is worked."""

    transmission = "nominal"
    is_adapted = True
    is_waiting = True
    touch_pressures_pa = (1.5e5, 1.5e5)

    def believe(self, touch_pressures_pa: tuple[float, float]) -> None:
        self.touch_pressures_pa = touch_pressures_pa

    def begin_routine(self, request: Routine) -> None:
        """Do nothing."""

    def begin_steps(self, steps: PressureSteps) -> None:
        """Do nothing."""

    def stop_steps(self) -> None:
        """Do nothing."""


class FullDisk(Controller):
    """A controller that can keep nothing."""

    def adapt(self, adaptation: Adaptation) -> None:
        """Refuse."""
        raise RecordError(f"no room for {adaptation}")


class Workshop:
    def __init__(self, kind: type[Controller] = Controller) -> None:
        self.car = Car()
        self.controller = kind(shipped_table(), values=lambda: PARKED, clock=lambda: 0.0, chance=bytes)
        self.monitoring = Monitoring(self.controller)
        adaptation = RequestedAdaptation(self.car, self.controller)
        self.clearing = RequestedClearing(self.controller, self.monitoring, adaptation)

    def ask(self, request: str) -> str:
        return (self.controller.ask(bytes.fromhex(request)) or b"").hex(" ")

    def start(self) -> str:
        for request in ("10 03", "27 01", "27 02 5a a5 c3 3d"):  # of zeros the seed ends with 1
            self.ask(request)
        return self.ask("31 01 03 03")

    def do_it(self) -> str:
        """Let everything happen that is asked for; return the response that was promised."""
        self.clearing.step()
        return (self.controller.tick() or b"").hex(" ")

    @property
    def status(self) -> Status:
        return self.controller.state.memory.records[NOT_LEARNED].status


@pytest.fixture(name="shop")
def _shop() -> Workshop:
    return Workshop()


def test_the_control_works_by_the_type_and_the_code_stays_until_both_clutches_are_adapted(shop: Workshop) -> None:
    assert shop.do_it() == ""
    assert shop.start() == "7f 31 78"
    assert shop.do_it() == "71 01 03 03 00"
    assert shop.car.touch_pressures_pa == NOMINAL_PA
    for points in ({}, {1: POINTS[1]}):
        shop.controller.adapt(Adaptation(touch_points=points))
        shop.monitoring.judge_adaptation()
        assert shop.status & Status.TEST_FAILED
    shop.controller.adapt(Adaptation(touch_points=POINTS))
    shop.monitoring.judge_adaptation()
    assert not shop.status & Status.TEST_FAILED


def test_the_code_is_there_when_the_tester_is_answered(shop: Workshop) -> None:
    shop.monitoring.judge_adaptation()
    assert not shop.status & Status.TEST_FAILED
    shop.start()
    assert shop.do_it() == "71 01 03 03 00"
    assert shop.status & Status.TEST_FAILED


def test_what_could_not_be_cleared_is_refused_and_leaves_no_code() -> None:
    shop = Workshop(FullDisk)
    shop.start()
    assert shop.do_it() == "7f 31 72"
    assert not shop.status & Status.TEST_FAILED
    assert shop.car.touch_pressures_pa == Car.touch_pressures_pa


def test_clutches_that_were_never_adapted_by_a_tester_are_no_fault(shop: Workshop) -> None:
    shop.monitoring.judge_adaptation()
    assert not shop.status & (Status.TEST_FAILED | Status.NOT_TESTED_THIS_CYCLE)
