"""A machine that was busy receives frames late: that is told as lateness, not as loss and not as another sender."""

from dataclasses import replace

import numpy as np
import pytest

from canlog.arrays import Int64Array
from canlog.frames import FrameBatch
from clutch_results.records import Reason, Status
from diag_service.diagnosis.frame_counts import frames_line
from diag_service.service.session import SenderWatch
from tests.support.chain import DRIVE_S, Outcome, diagnosed, drive_frames, whole_drive
from tests.support.lateness import after_stalls

MENDED_S = 0.1  # so short a pause of the signals spoils no shift
AT_ONCE_S, QUICK_S, SLOW_S = 0.0, 3e-4, 1.2e-3  # between frames that have gathered; SLOW_S: hardly faster than sent


def assert_all_frames_are_used(outcome: Outcome) -> None:
    assert outcome.counts.decoded == whole_drive().counts.decoded
    assert outcome.counts.missing == 0
    assert outcome.counts.rejected_count == 0
    assert SenderWatch().look(outcome.counts) is None


def reasons(outcome: Outcome) -> set[Reason]:
    return {reason for one in outcome.diagnoses for reason in one.estimate.reasons}


def stall_places() -> list[float]:
    """Return where in the drive a stall hurts: before, in and at the end of the second shift."""
    second = whole_drive().diagnoses[1].estimate
    first_ns = int(drive_frames().t_ns[0])
    start_s, end_s = (1e-9 * (t_ns - first_ns) for t_ns in (second.start_ns, second.end_ns))
    return [start_s - 0.2, 0.5 * (start_s + end_s), end_s - 0.05]


def assert_as_on_time(outcome: Outcome) -> None:
    assert_all_frames_are_used(outcome)
    assert [one.estimate.status for one in outcome.diagnoses] == [Status.VALID] * 3
    for late, sound in zip(outcome.diagnoses, whole_drive().diagnoses, strict=True):
        assert late.estimate.friction is not None
        assert sound.estimate.friction is not None
        off = late.estimate.friction.mu_c - sound.estimate.friction.mu_c
        assert abs(off) < 0.5 * sound.estimate.friction.std_mu_c
    assert f"{outcome.counts.late} late, in bursts" in frames_line(outcome.counts)


@pytest.mark.parametrize(
    ("place", "stall_s", "step_s"),
    [
        (0, 0.16, SLOW_S),
        (0, 5.0, QUICK_S),
        (1, 1.1, SLOW_S),
        (1, 5.0, AT_ONCE_S),
        (2, 0.16, AT_ONCE_S),
        (2, 1.1, QUICK_S),
    ],
)
def test_shifts_of_which_all_frames_came_in_a_burst_are_estimated(place: int, stall_s: float, step_s: float) -> None:
    outcome = diagnosed([after_stalls(drive_frames(), [(stall_places()[place], stall_s)], step_s)])
    assert_as_on_time(outcome)
    assert outcome.counts.late > 400 * min(stall_s, 3.0)


@pytest.mark.parametrize("seed", range(2))
def test_a_machine_that_stalls_again_and_again_loses_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stalls_s = [(at, rng.uniform(0.02, 0.3)) for at in sorted(rng.uniform(0.5, DRIVE_S - 0.5, 10))]
    for step_s in (AT_ONCE_S, QUICK_S, SLOW_S):
        outcome = diagnosed([after_stalls(drive_frames(), stalls_s, step_s)])
        assert_all_frames_are_used(outcome)
        assert reasons(outcome) <= {Reason.TIME_UNSURE}


@pytest.mark.parametrize(("jitter_s", "seed"), [(0.01, 0), (0.05, 1), (0.2, 0)])
def test_a_reading_time_that_jitters_accuses_no_sensor(jitter_s: float, seed: int) -> None:
    by_ns = np.random.default_rng(seed).uniform(0.0, 1e9 * jitter_s, len(drive_frames())).astype(np.int64)
    outcome = diagnosed([replace(drive_frames(), t_ns=np.maximum.accumulate(drive_frames().t_ns + by_ns))])
    assert_all_frames_are_used(outcome)
    assert len(outcome.diagnoses) == 3
    assert reasons(outcome) <= {Reason.TIME_UNSURE}
    assert any(one.estimate.status is Status.VALID for one in outcome.diagnoses)


def at_looks(looks_ns: Int64Array) -> FrameBatch:
    """Return frames as a reader that looks now and then has them: all that has gathered gets the time of the look."""
    return replace(drive_frames(), t_ns=looks_ns[np.searchsorted(looks_ns, drive_frames().t_ns)])


@pytest.mark.parametrize(  # how long after the first frame; a cycle is sent within 6 ms
    ("tick_s", "first_ms"), [(0.0125, 7.0), (0.013, 0.0), (0.02, 2.5), (0.05, 0.0), (0.2, 0.5)]
)
def test_shifts_are_estimated_from_what_a_reader_saw_that_looks_now_and_then(tick_s: float, first_ms: float) -> None:
    looks_s = 1e-3 * first_ms + tick_s * np.arange(DRIVE_S / tick_s + 1)
    outcome = diagnosed([at_looks(drive_frames().t_ns[0] + np.rint(1e9 * looks_s).astype(np.int64))])
    assert_as_on_time(outcome)


@pytest.mark.parametrize(
    ("tick_ms", "first_ms"),
    [(5.0, 0.0), (9.99, 5.5), (10.0, 1.5), (10.01, 5.5), (12.5, 0.0), (20.01, 9.0), (120.02, 0.0), (250.0, 9.0)],
)
def test_a_reader_in_step_with_the_senders_finds_the_shifts_and_accuses_no_sensor(
    tick_ms: float, first_ms: float
) -> None:
    """A cycle that a look cuts in two is not told from one that was sent otherwise: that is a doubt of the time."""
    looks_ms = first_ms + tick_ms * np.arange(1e3 * DRIVE_S / tick_ms + 1)
    outcome = diagnosed([at_looks(drive_frames().t_ns[0] + np.rint(1e6 * looks_ms).astype(np.int64))])
    assert_all_frames_are_used(outcome)
    assert len(outcome.diagnoses) == 3
    assert reasons(outcome) <= {Reason.TIME_UNSURE}


def test_frames_on_time_are_not_late() -> None:
    assert whole_drive().counts.late == 0
    assert "late" not in frames_line(whole_drive().counts)


@pytest.mark.parametrize("pause_s", [0.05, 0.3, 1.5])
def test_a_sender_that_paused_is_not_late(pause_s: float) -> None:
    """Its counters go on where they stood, but nothing gathered meanwhile: it did not measure, and its time stands."""
    at_ns = drive_frames().t_ns[0] + round(1e9 * stall_places()[1])
    moved = np.where(drive_frames().t_ns > at_ns, drive_frames().t_ns + round(1e9 * pause_s), drive_frames().t_ns)
    outcome = diagnosed([replace(drive_frames(), t_ns=moved)])
    assert outcome.counts.late == 0
    assert [one.estimate.status for one in outcome.diagnoses].count(Status.VALID) == 2 + (pause_s < MENDED_S)
    assert outcome.diagnoses[-1].estimate.end_ns - whole_drive().diagnoses[-1].estimate.end_ns == round(1e9 * pause_s)


@pytest.mark.parametrize("quick_frames", [100, 700])
def test_frames_behind_a_cut_are_not_late(quick_frames: int) -> None:
    """Some seconds that are missing from a log are a gap, though what follows comes in quick succession."""
    rows = np.flatnonzero(drive_frames().t_ns - drive_frames().t_ns[0] > 4e9)
    later = drive_frames()[rows[1000] :]
    quicker_ns = np.minimum(later.t_ns - later.t_ns[0], later.t_ns[quick_frames] - later.t_ns[0]) * 3 // 4
    outcome = diagnosed([drive_frames()[: rows[0]], replace(later, t_ns=later.t_ns - quicker_ns)])
    assert Reason.TIME_UNSURE not in reasons(outcome)
    assert outcome.counts.rejected_count == 0
    assert outcome.diagnoses[-1].estimate.status is Status.VALID


@pytest.mark.parametrize(("stall_s", "step_s"), [(0.5, QUICK_S), (2.0, SLOW_S)])
def test_how_a_late_stream_is_cut_changes_nothing(stall_s: float, step_s: float) -> None:
    late = after_stalls(drive_frames(), [(stall_places()[1], stall_s)], step_s)
    pieces = [late[start : start + 7] for start in range(0, len(late), 7)]
    assert diagnosed(pieces).fingerprint == diagnosed([late]).fingerprint


def test_a_stream_that_ends_in_a_burst_is_used_to_its_end() -> None:
    late = after_stalls(drive_frames(), [(DRIVE_S - 2.0, 1.99)], AT_ONCE_S)
    assert diagnosed([late]).fingerprint == whole_drive().fingerprint
