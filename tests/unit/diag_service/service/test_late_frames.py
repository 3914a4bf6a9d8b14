"""A machine that was busy receives frames late: that is told as lateness, not as loss and not as another sender."""

from functools import cache

import numpy as np
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
QUICK_S, SLOW_S = 3e-4, 1.2e-3  # from frame to frame of what has gathered: at once, or hardly faster than it was sent
TOLD = {Reason.TIME_UNSURE, Reason.INTERRUPTED}


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


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("stall_s", [0.16, 0.2, 0.3, 0.5, 0.8])
def test_shifts_of_which_all_frames_came_in_a_burst_are_estimated(place: int, stall_s: float) -> None:
    outcome = diagnosed([after_stalls(frames(), [(stall_places()[place], stall_s)], 2e-5)])
    assert_all_frames_are_used(outcome)
    assert [one.estimate.status for one in outcome.diagnoses] == [Status.VALID] * 3
    for late, sound in zip(outcome.diagnoses, whole().diagnoses, strict=True):
        assert late.estimate.friction is not None
        assert sound.estimate.friction is not None
        off = late.estimate.friction.mu_c - sound.estimate.friction.mu_c
        assert abs(off) < 0.5 * sound.estimate.friction.std_mu_c
    assert outcome.counts.late > 0
    assert f"{outcome.counts.late} late, in bursts" in frames_line(outcome.counts)


@pytest.mark.parametrize("step_s", [QUICK_S, SLOW_S])
@pytest.mark.parametrize("stall_s", [0.2, 0.5, 1.0, 2.0, 5.0])
def test_what_a_stall_spoils_is_called_late_and_nothing_is_missing(stall_s: float, step_s: float) -> None:
    for at_s in stall_places():
        outcome = diagnosed([after_stalls(frames(), [(at_s, stall_s)], step_s)])
        assert_all_frames_are_used(outcome)
        assert reasons(outcome) <= TOLD


@pytest.mark.parametrize("seed", range(4))
def test_a_machine_that_stalls_again_and_again_loses_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stalls_s = [(at, rng.uniform(0.02, 0.3)) for at in sorted(rng.uniform(0.5, DURATION_S - 0.5, 10))]
    for step_s in (QUICK_S, SLOW_S):
        outcome = diagnosed([after_stalls(frames(), stalls_s, step_s)])
        assert_all_frames_are_used(outcome)
        assert reasons(outcome) <= TOLD


def test_frames_on_time_are_not_late() -> None:
    assert whole().counts.late == 0
    assert "late" not in frames_line(whole().counts)


def test_how_a_late_stream_is_cut_changes_nothing() -> None:
    late = after_stalls(frames(), [(stall_places()[1], 0.5)], QUICK_S)
    pieces = [late[start : start + 37] for start in range(0, len(late), 37)]
    assert diagnosed(pieces).fingerprint == diagnosed([late]).fingerprint
