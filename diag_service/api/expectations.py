"""Assertions on an analysis and on frames; their messages say what there was instead."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING

from clutch_results.records import Condition, ShiftResult, Status
from diag_service.api.analysis import Analysis
from diag_service.delivery.console import condition_words

if TYPE_CHECKING:
    import can

    from diag_service.api.live import BackgroundDiagnosis, LiveDiagnosis

    Diagnosed = Analysis | BackgroundDiagnosis | LiveDiagnosis

SHOWN_BYTES = 64
_Kind = tuple[bool, int]  # whether an identifier has 29 bits, and which it is


def expect_verdict(found: "Diagnosed", clutch: int, *conditions: Condition | str) -> None:
    """Fail unless the verdict on a clutch is one of these conditions, such as ``"good"``.

    Raises
    ------
    AssertionError
        With the verdict that there is and its reason, or that there is none on this clutch.
    ValueError
        If a condition is none.
    """
    wanted = [_condition(condition) for condition in conditions]
    verdicts = _analysis(found).verdicts
    names = " or ".join(condition_words(condition) for condition in wanted)
    if clutch not in verdicts:
        raise AssertionError(f"clutch {clutch} should be {names}, but no shift engaged it")
    verdict = verdicts[clutch]
    if verdict.condition not in wanted:
        raise AssertionError(
            f"clutch {clutch} should be {names}, but it is {condition_words(verdict.condition)}: {verdict.reason}"
        )


def expect_shifts(
    found: "Diagnosed", *, least: int, status: Status | str | None = Status.VALID
) -> tuple[ShiftResult, ...]:
    """Fail unless there are at least so many shifts of this status, by default valid ones; return them.

    Raises
    ------
    AssertionError
        With the shifts that there are, each with its status and reasons.
    """
    results = _analysis(found).results
    matching = tuple(result for result in results if status is None or result.estimate.status == Status(status))
    if len(matching) < least:
        what = "" if status is None else f"{Status(status).value} "
        raise AssertionError(f"there should be {least} {what}shifts or more, but there are: {_shift_words(results)}")
    return matching


def expect_frames(found: "Diagnosed", *, least: int = 1, rejected: int = 0, missing: int = 0, dropped: int = 0) -> None:
    """Fail unless enough frames were decoded, and at most so many were bad.

    Parameters
    ----------
    least
        Frames of the known messages.
    rejected
        Frames that are not to be believed: a wrong CRC, a counter that stands or jumps, a wrong length, ...
    missing
        Frames that were sent and did not come, as the alive counters tell.
    dropped
        Frames that this machine was too slow for.

    Raises
    ------
    AssertionError
        With all of these numbers.
    """
    frames = _analysis(found).frames
    counts = {
        "rejected": (sum(frames["rejected"].values()), rejected),
        "missing": (frames["missing"], missing),
        "dropped": (frames["kernel_dropped"] + frames["queue_dropped"], dropped),
    }
    bad = [f"{count} {name} ({most} allowed)" for name, (count, most) in counts.items() if count > most]
    if frames["decoded"] < least:
        bad.insert(0, f"{frames['decoded']} decoded ({least} needed)")
    if bad:
        reasons = {reason: count for reason, count in frames["rejected"].items() if count}
        raise AssertionError(f"of {frames['on_bus']} frames: {', '.join(bad)}; reasons: {reasons or 'none'}")


def expect_same_frames(
    sent: Iterable["can.Message"],
    received: Iterable["can.Message"],
    *,
    can_ids: Iterable[int] | None = None,
    unseen_at_end: int = 0,
) -> None:
    """Fail unless every frame that was sent was received with the same bytes, each identifier in its own order.

    Parameters
    ----------
    can_ids
        The identifiers that matter; without them all that were sent, and no others may have come.
    unseen_at_end
        How many of the last frames of an identifier may still be on their way.

    Raises
    ------
    AssertionError
        Naming the first frame of each identifier that was lost, altered or added, up to a few.
    """
    wanted = None if can_ids is None else frozenset(can_ids)
    left, right = _payloads(sent, wanted), _payloads(received, wanted)
    if not left:
        raise AssertionError("no frame was sent that could be compared")
    kinds = sorted(left.keys() | right.keys())
    problems = [
        text for kind in kinds if (text := _difference(kind[1], left.get(kind, ()), right.get(kind, ()), unseen_at_end))
    ]
    if problems:
        raise AssertionError(f"{len(problems)} of {len(kinds)} identifiers differ: {'; '.join(problems[:4])}")


def _payloads(messages: Iterable["can.Message"], wanted: frozenset[int] | None) -> Mapping[_Kind, Sequence[bytes]]:
    payloads: dict[_Kind, list[bytes]] = defaultdict(list)
    for message in messages:
        if wanted is None or message.arbitration_id in wanted:
            payloads[message.is_extended_id, message.arbitration_id].append(bytes(message.data))
    return payloads


def _difference(can_id: int, sent: Sequence[bytes], received: Sequence[bytes], unseen_at_end: int) -> str:
    """Return what happened to the first frame that is not as it was sent; empty if all are."""
    if len(received) < len(sent) <= len(received) + unseen_at_end:
        sent = sent[: len(received)]
    pairs = enumerate(zip_longest(sent, received))
    number = next((number for number, (left, right) in pairs if left != right), None)
    if number is None:
        return ""
    left, after_left = [*sent[number : number + 2], None, None][:2]
    right, after_right = [*received[number : number + 2], None, None][:2]
    if left is not None and (left, right) == (after_right, after_left):
        what = f"{_hex(left)} and {_hex(right)} came in the wrong order"
    elif right is None or (right == after_left and right != after_right):
        what = f"{_hex(left)} did not come"
    elif left is None or left == after_right:
        what = f"{_hex(right)} came and was not sent"
    else:
        what = f"{_hex(left)} came as {_hex(right)}"
    return f"{can_id:X} ({len(sent)} sent, {len(received)} received), frame {number + 1}: {what}"


def _hex(data: bytes | None) -> str:
    return "-" if data is None else data[:SHOWN_BYTES].hex(" ").upper()


def _analysis(found: "Diagnosed") -> Analysis:
    return found if isinstance(found, Analysis) else found.analysis


def _condition(condition: Condition | str) -> Condition:
    if isinstance(condition, Condition):
        return condition
    try:
        return Condition[condition.upper().replace(" ", "_")]
    except KeyError:
        raise ValueError(
            f"{condition!r} is not a condition: {', '.join(condition_words(each) for each in Condition)}"
        ) from None


def _shift_words(results: Sequence[ShiftResult]) -> str:
    words = [
        f"{result.estimate.from_gear}-{result.estimate.to_gear} {result.estimate.status.value}"
        + (f" ({', '.join(reason.value for reason in result.estimate.reasons)})" if result.estimate.reasons else "")
        for result in results
    ]
    return ", ".join(words) or "none"
