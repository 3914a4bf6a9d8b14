"""Answers that come late, busy controllers and those that ask for time: nothing is taken for what it is not."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import can
import pytest

from diag_service.errors import RefusedError, SilentError
from tests.integration.test_signal_asking import Canned
from workshop.tester.addresses import CanAddress
from workshop.tester.answers import BUSY, OpenRequests, belongs, is_data_answer
from workshop.tester.answers import TesterTiming as Timing
from workshop.tester.asking import dialogue_on
from workshop.tester.can_line import line_on

pytestmark = pytest.mark.asks

GEARBOX = CanAddress(request_id=0x7E1, response_id=0x7E9)
REFUSED, TORQUE = bytes.fromhex("22009A"), bytes.fromhex("22100C")
REFUSAL, ANSWER = bytes.fromhex("7F2231"), bytes.fromhex("62100C0BB8")
LATE_S = 1.5  # later than a tester waits for a sample
FRAMES = {"22009A": (LATE_S, "03 7F 22 31"), "22100C": (0.05, "05 62 10 0C 0B B8")}


@contextmanager
def late_car(channel: str) -> Iterator[can.BusABC]:
    """Yield a tester's end of a bus whose controller refuses late, and answers one request after the other."""
    with (
        can.Bus(channel, "virtual") as near,
        can.Notifier(near, [Canned(near, FRAMES)], timeout=0.05),
        can.Bus(channel, "virtual") as tester,
    ):
        yield tester


def test_a_late_refusal_is_not_taken_for_that_of_the_next_request() -> None:
    with late_car("late-1") as bus, line_on(bus, [GEARBOX], is_fd=False, listen_s=0.05) as line:
        assert line.ask(REFUSED, GEARBOX) is None
        while (answer := line.ask(TORQUE, GEARBOX)) is None:  # the refusal is not there yet
            pass
        assert answer == ANSWER


def test_nor_is_it_by_the_commands_that_ask_one_controller() -> None:
    timing = Timing(p2_s=LATE_S / 3.0, most_silent=1)
    with late_car("late-2") as bus, dialogue_on(bus, GEARBOX, timing) as tester:
        with pytest.raises(SilentError):
            tester.ask(REFUSED)
        answer = b""
        while not answer:
            with suppress(SilentError):
                answer = tester.ask(TORQUE)
        assert answer == ANSWER


@pytest.mark.parametrize("belonging", [belongs, is_data_answer])
def test_a_refusal_belongs_to_the_oldest_request_that_is_open(belonging: Callable[[bytes, bytes], bool]) -> None:
    waiting = OpenRequests(belonging)
    waiting.begin(REFUSED, 0.0)
    waiting.begin(TORQUE, 1.0)
    assert waiting.answered_by(REFUSAL) == REFUSED
    assert waiting.answered_by(REFUSAL) == TORQUE
    assert waiting.answered_by(REFUSAL) is None  # nothing is open
    waiting.begin(REFUSED, 2.0)
    waiting.begin(TORQUE, 3.0)
    assert waiting.answered_by(ANSWER) == TORQUE  # in order: the other one was lost
    assert waiting.answered_by(REFUSAL) is None
    waiting.begin(REFUSED, 4.0)
    waiting.begin(TORQUE, 60.0)
    assert waiting.answered_by(REFUSAL) == TORQUE  # nobody answers after a minute


def test_a_controller_that_stays_busy_is_called_busy() -> None:
    timing = Timing(busy_pause_s=0.001, p2_s=20.0)  # only a hang takes so long
    with (
        can.Bus("late-3", "virtual") as near,
        can.Notifier(near, [Canned(near, {"22100C": ("03 7F 22 21",)})], timeout=0.05),
        can.Bus("late-3", "virtual") as bus,
        dialogue_on(bus, GEARBOX, timing) as tester,
        pytest.raises(
            RefusedError, match=r"is busy \(asked for 22 10 0C 7 times in [0-9]+ s\): try again later"
        ) as refused,
    ):
        tester.ask(TORQUE)
    assert refused.value.code == BUSY
