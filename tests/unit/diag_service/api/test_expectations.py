"""What tests expect, and what they are told when it is not so."""

from dataclasses import replace

import can
import pytest

from clutch_results.records import Condition, ShiftStatistics
from diag_service.api.analysis import Analysis
from diag_service.api.expectations import expect_frames, expect_same_frames, expect_shifts, expect_verdict
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.diagnosis.summary import Summary, summary_record
from tests.support.builders import rejected, shift_result

FRAMES = FrameCounts(
    on_bus=100, decoded=80, ignored=13, rejected={"bad_crc": 5, "short": 0}, queue_dropped=2, missing=4
)


def found(*, frames: FrameCounts = FRAMES) -> Analysis:
    results = [shift_result(1), rejected(shift_result(2))]
    statistics = ShiftStatistics()
    for result in results:
        statistics = statistics.with_shift(result, is_new=True)
    summary = Summary(vehicle="car1", frames=frames, shifts=statistics, unpublished_count=None)
    return Analysis(paths=(), results=tuple(results), summary=summary_record(summary))


def message(can_id: int, *data: int) -> can.Message:
    return can.Message(arbitration_id=can_id, data=bytes(data), is_extended_id=False)


def told(sent: list[can.Message], received: list[can.Message], **options: int) -> str:
    with pytest.raises(AssertionError) as failure:
        expect_same_frames(sent, received, unseen_at_end=options.get("unseen_at_end", 0))
    return str(failure.value)


def test_a_verdict_is_one_of_those_that_are_named() -> None:
    analysis = found()
    (clutch,) = analysis.verdicts
    condition = analysis.verdicts[clutch].condition
    expect_verdict(analysis, clutch, condition)
    expect_verdict(analysis, clutch, "change fluid", condition.name.lower())
    other = next(one for one in Condition if one is not condition)
    with pytest.raises(AssertionError, match=rf"^clutch {clutch} should be {other.name.lower()}.*, but it is "):
        expect_verdict(analysis, clutch, other)
    with pytest.raises(AssertionError, match="no shift engaged it"):
        expect_verdict(analysis, 3 - clutch, condition)
    with pytest.raises(ValueError, match="'fine' is not a condition: no verdict, good, watch, change fluid"):
        expect_verdict(analysis, clutch, "fine")


def test_shifts_are_counted_by_their_status() -> None:
    analysis = found()
    assert len(expect_shifts(analysis, least=1)) == 1
    assert len(expect_shifts(analysis, least=2, status=None)) == 2
    assert expect_shifts(analysis, least=1, status="rejected")[0].seq == 2
    with pytest.raises(
        AssertionError, match=r"should be 2 valid shifts or more, but there are: 1-2 valid, 1-2 rejected$"
    ):
        expect_shifts(analysis, least=2)


def test_frames_are_held_against_what_is_allowed() -> None:
    expect_frames(found(), least=80, rejected=5, missing=4, dropped=2)
    with pytest.raises(AssertionError) as failure:
        expect_frames(found(), least=81, rejected=4)
    assert str(failure.value) == (
        "of 100 frames: 80 decoded (81 needed), 5 rejected (4 allowed), 4 missing (0 allowed), "
        "2 dropped (0 allowed); reasons: {'bad_crc': 5}"
    )
    expect_frames(found(frames=replace(FRAMES, rejected={}, queue_dropped=0, missing=0)))


def test_a_frame_that_is_lost_altered_added_or_late_is_named() -> None:
    sent = [message(0xA0, number, 0) for number in range(5)]
    assert told(sent, [*sent[:2], *sent[3:]]) == (
        "1 of 1 identifiers differ: A0 (5 sent, 4 received), frame 3: 02 00 did not come"
    )
    assert told(sent, sent[:4]).endswith("frame 5: 04 00 did not come")
    assert told(sent, sent[:3], unseen_at_end=1).endswith("frame 4: 03 00 did not come")
    assert told(sent, [*sent[:2], message(0xA0, 2, 16), *sent[3:]]).endswith("frame 3: 02 00 came as 02 10")
    assert told(sent, [*sent[:2], sent[1], *sent[2:]]).endswith("frame 3: 01 00 came and was not sent")
    assert told(sent, [*sent, message(0xB0, 9)]).endswith("B0 (0 sent, 1 received), frame 1: 09 came and was not sent")
    assert told(sent, [sent[0], sent[2], sent[1], *sent[3:]]).endswith(
        "frame 2: 01 00 and 02 00 came in the wrong order"
    )
