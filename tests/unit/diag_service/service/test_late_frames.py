"""A machine that was busy receives frames late: that is told as lateness, not as loss and not as another sender."""

from dataclasses import replace
from functools import cache

import pytest

from canlog.frames import FrameBatch
from diag_service.diagnosis.records import Reason, Status
from diag_service.diagnosis.summary import frames_line
from diag_service.service.session import SenderWatch
from ecu_emulator.drive.recording import Drive
from tests.support.builders import drive_scenario
from tests.support.chain import Outcome, diagnosed
from tests.support.lateness import after_stalls
from tests.support.wire import received

DURATION_S = 10.0  # three shifts
AT_ONCE_S, QUICK_S, SLOW_S = 0.0, 3e-4, 1.2e-3  # between frames that have gathered; SLOW_S: hardly faster than sent


@cache
def frames() -> FrameBatch:
    return received(next(Drive(drive_scenario("ideal")).stretches(DURATION_S)).frames)


@cache
def whole() -> Outcome:
    return diagnosed([frames()])


def assert_all_frames_are_used(outcome: Outcome) -> None:
    assert outcome.counts.decoded == whole().counts.decoded
    assert outcome.counts.missing == 0
    assert outcome.counts.rejected_count == 0
    assert SenderWatch().look(outcome.counts) is None


def reasons(outcome: Outcome) -> set[Reason]:
    return {reason for one in outcome.diagnoses for reason in one.estimate.reasons}


def stall_places() -> list[float]:
    """Return where in the drive a stall hurts: before, in and at the end of the second shift."""
    second = whole().diagnoses[1].estimate
    first_ns = int(frames().t_ns[0])
    start_s, end_s = (1e-9 * (t_ns - first_ns) for t_ns in (second.start_ns, second.end_ns))
    return [start_s - 0.2, 0.5 * (start_s + end_s), end_s - 0.05]


def assert_as_on_time(outcome: Outcome) -> None:
    assert_all_frames_are_used(outcome)
    assert [one.estimate.status for one in outcome.diagnoses] == [Status.VALID] * 3
    for late, sound in zip(outcome.diagnoses, whole().diagnoses, strict=True):
        assert late.estimate.friction is not None
        assert sound.estimate.friction is not None
        off = late.estimate.friction.mu_c - sound.estimate.friction.mu_c
        assert abs(off) < 0.5 * sound.estimate.friction.std_mu_c
    assert f"{outcome.counts.late} late, in bursts" in frames_line(outcome.counts)


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("step_s", [AT_ONCE_S, QUICK_S, SLOW_S])
@pytest.mark.parametrize("stall_s", [0.16, 0.5, 1.1, 5.0])
def test_shifts_of_which_all_frames_came_in_a_burst_are_estimated(place: int, stall_s: float, step_s: float) -> None:
    outcome = diagnosed([after_stalls(frames(), [(stall_places()[place], stall_s)], step_s)])
    assert_as_on_time(outcome)
    assert outcome.counts.late > 400 * min(stall_s, 3.0)


@pytest.mark.parametrize("tick_s", [0.02, 0.03, 0.05, 0.1, 0.2])
def test_a_reader_that_looks_now_and_then_accuses_no_sensor(tick_s: float) -> None:
    """All that has gathered gets the time of the look."""
    first_ns, tick_ns = int(frames().t_ns[0]), round(1e9 * tick_s)
    outcome = diagnosed([replace(frames(), t_ns=first_ns - (first_ns - frames().t_ns) // tick_ns * tick_ns)])
    assert_all_frames_are_used(outcome)
    assert reasons(outcome) <= {Reason.TIME_UNSURE, Reason.NO_SLIP_WINDOW}


@pytest.mark.parametrize("stall_s", [0.5, 2.0])
@pytest.mark.parametrize("step_s", [AT_ONCE_S, QUICK_S, SLOW_S])
def test_how_a_late_stream_is_cut_changes_nothing(stall_s: float, step_s: float) -> None:
    late = after_stalls(frames(), [(stall_places()[1], stall_s)], step_s)
    for size in (1, 37):
        pieces = [late[start : start + size] for start in range(0, len(late), size)]
        assert diagnosed(pieces).fingerprint == diagnosed([late]).fingerprint
