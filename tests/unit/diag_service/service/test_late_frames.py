"""Frames that come late, and two senders of the same messages."""

from dataclasses import replace
from functools import cache

import pytest

from canlog.frames import FrameBatch, join
from diag_service.diagnosis.records import Reason, Status
from diag_service.diagnosis.summary import FrameCounts, frames_line
from diag_service.service.session import SenderWatch
from ecu_emulator.drive.recording import Drive, frames_of
from ecu_emulator.scenario.scenario_file import load_scenario, parse_scenario
from tests.support.builders import drive_scenario
from tests.support.chain import Outcome, diagnosed
from tests.support.lateness import after_stalls
from tests.support.traffic import as_received
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


def counts(decoded: int, wrong: int) -> FrameCounts:
    return FrameCounts(on_bus=decoded + wrong, decoded=decoded, rejected={"wrong_sequence": wrong})


def interleaved(*batches: FrameBatch) -> FrameBatch:
    """Return the frames of several senders in the order of their times."""
    frames = join(list(batches))
    order = frames.t_ns.argsort(kind="stable")
    return frames[order]


@pytest.mark.parametrize("delay_s", [0.0, 0.003, 0.05, 1.234])  # in step, or counting apart
def test_two_emulators_on_one_bus_are_told(delay_s: float) -> None:
    first, second = (as_received(frames_of(load_scenario(name))[0][:10_000]) for name in ("noise_only", "case2"))
    second = replace(second, t_ns=second.t_ns + round(delay_s * 1e9))
    text = SenderWatch().look(diagnosed([interleaved(first, second)]).counts)
    assert text is not None
    assert "two senders" in text


@pytest.mark.parametrize(
    "fault",
    [
        "",
        "[effects]\nframe_loss_ratio = 0.2\n",
        '[[bus_faults]]\nkind = "duplicate"\nshare = 0.1\n',
        '[[bus_faults]]\nkind = "restart"\nstart_s = 3\nduration_s = 1\n',
        '[[bus_faults]]\nkind = "bad_crc"\nshare = 0.5\n',
        '[[bus_faults]]\nkind = "silence"\nstart_s = 3\nduration_s = 5\n',
    ],
)
def test_one_sender_on_a_bad_bus_is_not(fault: str) -> None:
    frames, _ = frames_of(parse_scenario(f'name = "x"\n{fault}', "x"))
    assert SenderWatch().look(diagnosed([as_received(frames)]).counts) is None


def test_it_is_said_once_for_as_long_as_it_lasts_and_again_when_it_comes_back() -> None:
    watch = SenderWatch()
    seen = [(1_000, 0), (2_000, 800), (3_000, 1_600), (4_000, 1_600), (5_000, 2_400)]
    assert [watch.look(counts(*pair)) is not None for pair in seen] == [False, True, False, False, True]
