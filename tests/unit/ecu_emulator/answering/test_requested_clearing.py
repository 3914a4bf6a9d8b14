"""Clearing what was learned of the clutches: who is told, what the tester hears, and what the memory keeps of it."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from ecu_emulator.answering.monitoring import Monitoring
from ecu_emulator.answering.on_board import FixedEstimate
from ecu_emulator.answering.requested_tasks import RequestedClearing
from ecu_emulator.diagnostics.clutches import Adaptation, OnBoardFriction
from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.iso14229 import Status
from ecu_emulator.diagnostics.table_file import shipped_table
from ecu_emulator.scenario.scenario import FluidVerdict
from ecu_emulator.shift_control.touch_points import TouchPoint
from tests.support.patience import HANG_S
from tests.unit.ecu_emulator.diagnostics.bench import PARKED

NOT_LEARNED = 0x081054
GOOD = OnBoardFriction(fluid=FluidVerdict.GOOD)
UNKNOWN = OnBoardFriction()


class Estimate(FixedEstimate):
    """One that can begin anew, or not."""

    is_live = True

    def __init__(self, *, can_begin: bool) -> None:
        super().__init__(GOOD)
        self.can_begin = can_begin
        self.begun = 0

    def begin_anew(self) -> bool:
        self.begun += 1
        return self.can_begin


class Workshop:
    def __init__(self, estimate: FixedEstimate) -> None:
        self.controller = Controller(shipped_table(), values=lambda: PARKED, clock=lambda: 0.0, chance=bytes)
        self.monitoring = Monitoring(self.controller)
        self.clearing = RequestedClearing(estimate, self.controller, self.monitoring)

    def ask(self, request: str) -> str:
        return (self.controller.ask(bytes.fromhex(request)) or b"").hex(" ")

    def start(self) -> str:
        for request in ("10 03", "27 01", "27 02 5a a5 c3 3d"):  # of zeros the seed ends with 1
            self.ask(request)
        return self.ask("31 01 03 03")

    def do_it(self) -> str:
        """Let everything happen that is asked for; return the response that was promised."""
        self.clearing.step()
        if self.clearing._work is not None:
            self.clearing._work.result(HANG_S)
        self.clearing.step()
        return (self.controller.tick() or b"").hex(" ")

    @property
    def status(self) -> Status:
        return self.controller.state.memory.records[NOT_LEARNED].status


@contextmanager
def workshop(estimate: FixedEstimate) -> Iterator[Workshop]:
    shop = Workshop(estimate)
    try:
        yield shop
    finally:
        shop.clearing.close()


def test_the_estimate_begins_anew_once_and_the_code_stays_until_both_clutches_are_known() -> None:
    with workshop(estimate := Estimate(can_begin=True)) as shop:
        assert shop.start() == "7f 31 78"
        assert shop.do_it() == "71 01 03 03 00"
        assert shop.do_it() == ""
        assert estimate.begun == 1
        assert shop.status & Status.TEST_FAILED
        for estimates in ({}, {1: GOOD}, {1: GOOD, 2: UNKNOWN}):
            shop.monitoring.judge_clutches(estimates)
            assert shop.status & Status.TEST_FAILED
        shop.monitoring.judge_clutches({1: GOOD, 2: GOOD})
        assert not shop.status & Status.TEST_FAILED


def test_what_could_not_be_cleared_is_refused_and_leaves_no_code() -> None:
    with workshop(Estimate(can_begin=False)) as shop:
        shop.start()
        assert shop.do_it() == "7f 31 72"
        assert not shop.status & Status.TEST_FAILED


def test_a_tester_that_goes_meanwhile_does_not_undo_it() -> None:
    with workshop(estimate := Estimate(can_begin=True)) as shop:
        shop.start()
        shop.clearing.step()
        shop.controller.leave(0)
        assert shop.do_it() == ""
        assert shop.status & Status.TEST_FAILED
        assert shop.start() == "7f 31 78"
        assert shop.do_it() == "71 01 03 03 00"
        assert estimate.begun == 2


def test_touch_points_that_are_adapted_are_enough_unless_an_estimate_was_cleared() -> None:
    with workshop(Estimate(can_begin=True)) as shop:
        points = {clutch: TouchPoint(pressure_pa=1.4e5, std_pa=900.0) for clutch in (1, 2)}
        shop.controller.adapt(Adaptation())
        shop.monitoring.judge_clutches({})
        assert shop.status & Status.TEST_FAILED
        shop.controller.adapt(Adaptation(touch_points=points))
        shop.monitoring.judge_clutches({})  # the estimate on board has seen nothing yet
        assert not shop.status & Status.TEST_FAILED
        shop.controller.adapt(Adaptation(awaits_estimate=True))
        shop.monitoring.judge_clutches({})
        assert shop.status & Status.TEST_FAILED
        shop.controller.adapt(Adaptation(touch_points=points, awaits_estimate=True))
        shop.monitoring.judge_clutches({1: GOOD})
        assert shop.status & Status.TEST_FAILED
        shop.monitoring.judge_clutches({1: GOOD, 2: GOOD})
        assert not shop.status & Status.TEST_FAILED


def test_clutches_that_were_never_known_are_no_fault() -> None:
    with workshop(FixedEstimate(None)) as shop:
        shop.monitoring.judge_clutches({})
        assert shop.status & Status.NOT_TESTED_SINCE_CLEAR


@pytest.mark.parametrize(("estimate", "is_possible"), [(FixedEstimate(GOOD), False), (Estimate(can_begin=True), True)])
def test_an_estimate_that_nobody_learned_cannot_be_cleared(estimate: FixedEstimate, is_possible: bool) -> None:
    with workshop(estimate) as shop:
        assert shop.clearing.is_possible is is_possible
