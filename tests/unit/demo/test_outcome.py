"""The judgement on a demonstration: silent when all is well, and each thing that may go wrong is named."""

from dataclasses import replace

import pytest

from demo.outcome import (
    MAX_ERROR_STD,
    FrameAccount,
    Outcome,
    complaints,
    frame_account,
    frame_lines,
    tables,
    verdict_lines,
)
from diag_service.diagnosis.records import FrictionEstimate, Reason, Status
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


def test_an_error_within_the_limit_is_bad_luck() -> None:
    assert complaints(with_shift(good_outcome(), 3, off_by(0.99 * MAX_ERROR_STD))) == []


@pytest.mark.parametrize("std", [4.1, -4.1])
def test_an_error_beyond_the_limit_is_named(std: float) -> None:
    assert complaints(with_shift(good_outcome(), 3, off_by(std))) == [f"shift 3 (3-4): mu_S is off by {std:+.1f} std"]


def test_a_running_estimate_beyond_the_limit_is_named() -> None:
    outcome = good_outcome()
    state = replace(outcome.clutches[2], friction=off_by(5.0))
    found = complaints(replace(outcome, clutches={**outcome.clutches, 2: state}))
    assert found == ["the running estimate of clutch 2: mu_S is off by +5.0 std"]


def test_a_shift_that_did_not_arrive_is_missed() -> None:
    outcome = good_outcome()
    assert complaints(replace(outcome, shifts=outcome.shifts[:-1])) == ["9 of 10 shifts arrived"]


def test_a_shift_that_was_not_driven_is_named() -> None:
    outcome = good_outcome()
    first = outcome.shifts[0]
    other = replace(first, estimate=replace(first.estimate, from_gear=3))
    assert complaints(replace(outcome, shifts=(other, *outcome.shifts[1:]))) == ["shift 1 (3-2) was not driven"]


def test_a_drive_that_is_too_short_is_named() -> None:
    outcome = good_outcome()
    truth = replace(outcome.truth, shifts=outcome.truth.shifts[:4])
    assert complaints(replace(outcome, shifts=outcome.shifts[:4], truth=truth)) == [
        "the emulator drove 4 shifts, not 10"
    ]


def test_a_shift_without_an_estimate_is_named_with_its_reason() -> None:
    outcome = with_shift(good_outcome(), 2, None)
    second = outcome.shifts[1]
    estimate = replace(second.estimate, status=Status.REJECTED, reasons=(Reason.FRAMES_MISSING,))
    shifts = (outcome.shifts[0], replace(second, estimate=estimate), *outcome.shifts[2:])
    assert complaints(replace(outcome, shifts=shifts)) == ["shift 2 (2-3) gave no estimate: rejected, frames missing"]


def test_a_clutch_without_a_state_is_named() -> None:
    outcome = good_outcome()
    assert complaints(replace(outcome, clutches={1: outcome.clutches[1]})) == ["the service says nothing of clutch 2"]


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


def test_a_frame_that_came_late_is_nobody_elses() -> None:
    late = replace(good_frames(), missing=135, late=400, lateness_max_s=4.6)
    assert complaints(with_frames(late)) == []
    found = complaints(replace(with_shift(good_outcome(), 2, None), frames=late))
    assert "too busy to send in time (at most 4.6 s late)" in found[-1]


def test_the_account_takes_the_reports_of_both_programs() -> None:
    transmitted = {"frames_sent": 12, "frames_given_up": 1, "lateness_max_s": 0.002, "drift_ppm": 0.0}
    received = {
        "on_bus": 12, "decoded": 8, "ignored": 1, "rejected": {"bad_crc": 1}, "kernel_dropped": 1, "queue_dropped": 1,
        "missing": 2, "late": 0, "invalid_values": 0,
    }  # fmt: skip
    account = frame_account(transmitted, received)
    assert (account.sent, account.arrived, account.dropped, account.unexplained) == (12, 10, 2, 0)


def test_the_tables_have_a_row_for_each_shift_and_clutch() -> None:
    outcome = with_shift(good_outcome(), 2, None)
    assert [table.row_count for table in tables(outcome)] == [10, 2]


def test_the_frame_lines_name_the_reasons() -> None:
    lines = list(frame_lines(replace(good_frames(), decoded=980, rejected={"bad_crc": 10})))
    assert "1000 frames sent" in lines[0]
    assert "10 rejected (10 bad crc)" in lines[1]


def test_the_verdict_can_be_found_by_a_script_and_below_it_stands_what_to_do() -> None:
    outcome = good_outcome()
    silent = replace(outcome, clutches={**outcome.clutches, 2: replace(outcome.clutches[2], advice=None)})
    assert [line.plain for line in verdict_lines(silent)] == [
        "verdict: clutch 1 good",
        "         Clutch 1: nothing to do.",
        "verdict: clutch 2 good",
    ]
