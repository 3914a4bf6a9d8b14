"""The judgement on a demonstration: silent when all is well, and each thing that may go wrong is named."""

from dataclasses import replace

import pytest

from clutch_results.records import FrictionEstimate
from demo.outcome import FrameAccount, Outcome, complaints, frame_account, lateness_text
from tests.unit.demo.outcomes import FRICTION, good_frames, good_outcome


def off_by(std: float) -> FrictionEstimate:
    return replace(FRICTION, mu_s=FRICTION.mu_s + std * FRICTION.std_mu_s)


def with_shift(outcome: Outcome, number: int, friction: FrictionEstimate | None) -> Outcome:
    shifts = list(outcome.shifts)
    result = shifts[number - 1]
    shifts[number - 1] = replace(result, estimate=replace(result.estimate, friction=friction))
    return replace(outcome, shifts=tuple(shifts))


def with_frames(frames: FrameAccount) -> Outcome:
    return replace(good_outcome(), frames=frames)


def test_nothing_is_wrong_with_a_good_demonstration() -> None:
    assert complaints(good_outcome()) == []


@pytest.mark.parametrize("std", [4.1, -4.1])
def test_an_error_beyond_the_limit_is_named(std: float) -> None:
    assert complaints(with_shift(good_outcome(), 3, off_by(std))) == [f"shift 3 (3-4): mu_S is off by {std:+.1f} std"]


def test_a_shift_that_did_not_arrive_is_missed() -> None:
    outcome = good_outcome()
    assert complaints(replace(outcome, shifts=outcome.shifts[:-1])) == ["9 of 10 shifts arrived"]


@pytest.mark.parametrize(
    ("frames", "complaint"),
    [
        (replace(good_frames(), given_up=3), "the bus did not take 3 frames"),
        (replace(good_frames(), sent=1002), "2 of 1002 frames were lost without a trace"),
        (replace(good_frames(), sent=990), "10 frames on the bus were not the emulator's"),
        (replace(good_frames(), on_bus=1001), "1001 frames were on the bus, the service accounts for 1000"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_frames_that_do_not_add_up_are_named(frames: FrameAccount, complaint: str) -> None:
    assert complaints(with_frames(frames)) == [complaint]


@pytest.mark.parametrize(
    "frames",
    [
        replace(good_frames(), decoded=980, rejected={"bad_crc": 10}),
        replace(good_frames(), on_bus=990, decoded=980, missing=10),
        replace(good_frames(), decoded=980, dropped=10, missing=10),
    ],
    ids=["rejected", "missing by alive counters", "dropped by the kernel"],
)
def test_a_loss_that_was_noticed_is_explained(frames: FrameAccount) -> None:
    assert complaints(with_frames(frames)) == []


def test_only_a_drive_that_was_sent_late_and_failed_is_blamed_on_a_busy_machine() -> None:
    late = replace(good_frames(), lateness_max_s=2.34)
    assert lateness_text(with_frames(late)) is None
    assert lateness_text(with_frames(replace(good_frames(), given_up=3))) is None
    assert lateness_text(with_frames(replace(late, given_up=3))) == (
        "this machine was too busy to send in time (at most 2.3 s late; the bus did not take 3 frames)"
    )


def test_the_account_takes_the_reports_of_both_programs() -> None:
    transmitted = {"frames_sent": 12, "frames_given_up": 1, "lateness_max_s": 0.002, "drift_ppm": 0.0}
    received = {
        "on_bus": 12, "decoded": 8, "ignored": 1, "rejected": {"bad_crc": 1}, "kernel_dropped": 1, "queue_dropped": 1,
        "missing": 2, "late": 0, "invalid_values": 0,
    }  # fmt: skip
    account = frame_account(transmitted, received)
    assert (account.sent, account.arrived, account.dropped, account.unexplained) == (12, 10, 2, 0)
