"""Frames are protected and judged as an independent implementation of AUTOSAR E2E profile 1 does."""

from collections.abc import Sequence
from typing import Final

import e2e.p01
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from canlog.e2e.profile1 import COUNTER_PERIOD, counter_of, crc_is_valid, data_id_remainder, protect
from canlog.e2e.protection_check import FrameReason, FrameVerdicts, LinkMonitor
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch
from tests.support.batches import frames_at
from tests.support.wire import CONTRACTS, DATABASE, START_NS

NAME: Final = "TCU_Pressures"
DATA_ID: Final = CONTRACTS[NAME].data_id or 0
CYCLE_MS: Final = 10

OK = FrameReason.OK
REPEATED = FrameReason.REPEATED
WRONG_SEQUENCE = FrameReason.WRONG_SEQUENCE


def frames(counters: Sequence[int], t_ms: Sequence[float] | None = None, damaged: Sequence[int] = ()) -> FrameBatch:
    """Return frames of one message, one cycle apart unless times are given; ``damaged`` rows get a bad CRC."""
    count = len(counters)
    times = np.arange(count) * float(CYCLE_MS) if t_ms is None else np.array(t_ms, np.float64)
    data = protect(np.full((count, 8), 0x50, np.uint8), DATA_ID, np.array(counters, np.int64))
    data[list(damaged), 0] ^= 0x55
    return frames_at(START_NS + (times * 1e6).astype(np.int64), CONTRACTS[NAME].can_id, data=data)


def monitor() -> LinkMonitor:
    return LinkMonitor([DATABASE.get_message_by_name(NAME)])


def check(batch: FrameBatch) -> tuple[LinkMonitor, FrameVerdicts]:
    link = monitor()
    return link, link.check(batch)


def reasons(verdicts: FrameVerdicts) -> list[FrameReason]:
    return [FrameReason(reason) for reason in verdicts.reason.tolist()]


@pytest.mark.parametrize("lost", [1, 2, 7, 13, 14, 15, 16, 29, 30, 45, 99])
def test_lost_frames_are_counted_by_counter_and_time(lost: int) -> None:
    numbers = [0, 1, 2, 3 + lost, 4 + lost, 5 + lost]
    link, verdicts = check(frames([n % 15 for n in numbers], [n * CYCLE_MS for n in numbers]))
    assert reasons(verdicts) == [OK] * 6
    assert verdicts.sequence.tolist() == numbers
    assert verdicts.missing.tolist() == [0, 0, 0, lost, 0, 0]
    assert link.missing.tolist() == [lost]


def test_stuck_counter_rejects_until_it_moves() -> None:
    link, verdicts = check(frames([3, 4, *[4] * 40, 5, 6]))
    assert reasons(verdicts) == [OK, OK, *[REPEATED] * 40, OK, OK]
    assert link.missing.tolist() == [0]
    assert (np.diff(verdicts.sequence[verdicts.sequence >= 0]) > 0).all()


def test_stray_frame_costs_only_itself() -> None:
    link, verdicts = check(frames([5, 6, 2, 7, 8], [0, 10, 15, 20, 30]))
    assert reasons(verdicts) == [OK, OK, WRONG_SEQUENCE, OK, OK]
    assert verdicts.sequence.tolist() == [0, 1, -1, 2, 3]
    assert link.missing.tolist() == [0]


@pytest.mark.parametrize("before", range(15))
@pytest.mark.parametrize("pause_ms", [10, 20, 45, 150, 400])
def test_restart_of_a_sender_costs_no_more_than_promised(before: int, pause_ms: int) -> None:
    counters = [*((before - 3 + k) % 15 for k in range(4)), *range(10)]
    times = [*range(0, 40, 10), *(30 + pause_ms + 10 * k for k in range(10))]
    _, verdicts = check(frames(counters, times))
    rejected = [reason for reason in reasons(verdicts) if reason != OK]
    assert len(rejected) <= 1
    assert (np.diff(verdicts.sequence[verdicts.sequence >= 0]) > 0).all()


@pytest.mark.parametrize("first", range(15))
def test_a_sender_that_was_off_for_long_has_lost_nothing_and_may_begin_with_any_counter(first: int) -> None:
    link, verdicts = check(
        frames([7, 8, 9, *((first + k) % 15 for k in range(9))], [0, 10, 20, *range(60_020, 60_110, 10)])
    )
    assert reasons(verdicts) == [OK] * 12
    assert verdicts.sequence.tolist() == [0, 1, 2, *range(6002, 6011)]
    assert link.missing.tolist() == [0]


@pytest.mark.parametrize("step_ms", [0.1, 4.0, 6.0, 8.0])
def test_late_frames_are_not_missing_however_slowly_they_catch_up(step_ms: float) -> None:
    held = [210.0 + step_ms * k for k in range(100)]
    times = [*range(0, 60, 10), *(max(at, 60.0 + 10.0 * k) for k, at in enumerate(held))]
    link, verdicts = check(frames([k % 15 for k in range(len(times))], times))
    assert reasons(verdicts) == [OK] * len(times)
    assert link.missing.tolist() == [0]
    assert link.held_back.tolist() == [sum(np.diff(times) < 5.0)]


def test_frames_of_nobody_remote_and_error_frames() -> None:
    batch = frames([0, 1, 2, 3, 4])
    batch.can_id[1:] = [0x7FF, batch.can_id[1] | REMOTE_FLAG, ERROR_FLAG | 0x20, batch.can_id[4] | EXTENDED_FLAG]
    link, verdicts = check(batch)
    remote = FrameReason.REMOTE_OR_ERROR
    assert reasons(verdicts) == [OK, FrameReason.UNKNOWN_ID, remote, remote, FrameReason.UNKNOWN_ID]
    assert verdicts.slot.tolist()[:2] == [0, -1]
    assert link.counts.tolist()[0][OK] == 1
    assert link.counts.sum() == 5


UInt8Array = npt.NDArray[np.uint8]

payloads = hnp.arrays(np.uint8, st.tuples(st.integers(1, 20), st.just(8)))
data_ids = st.integers(0, 0xFFFF)


def oracle(payload: UInt8Array, data_id: int) -> bytes:
    """Return the payload as the independent implementation protects it, its counter kept."""
    buffer = bytearray(payload.tobytes())
    e2e.p01.e2e_p01_protect(buffer, data_id, increment_counter=False)
    return bytes(buffer)


@given(payloads, data_ids, st.integers(0, 1000))
def test_protect_agrees_with_the_oracle(data: UInt8Array, data_id: int, first: int) -> None:
    counter = first + np.arange(len(data))
    protected = protect(data, data_id, counter)
    assert counter_of(protected).tolist() == (counter % COUNTER_PERIOD).tolist()
    assert [row.tobytes() for row in protected] == [oracle(row, data_id) for row in protected]


@given(payloads, data_ids, st.booleans())
def test_check_agrees_with_the_oracle(data: UInt8Array, data_id: int, is_protected: bool) -> None:
    """The oracle's check is CRC and a counter that is one: 15 is not."""
    if is_protected:
        data[:, 0] = [oracle(row, data_id)[0] for row in data]
    expected = [bool(e2e.p01.e2e_p01_check(bytearray(row.tobytes()), data_id)) for row in data]
    is_counter = counter_of(data) < COUNTER_PERIOD
    assert (crc_is_valid(data, data_id_remainder(data_id)) & is_counter).tolist() == expected
    assert crc_is_valid(data, data_id_remainder(data_id)).all() or not is_protected


@given(hnp.arrays(np.uint8, (1, 8)), data_ids)
def test_every_single_bit_flip_is_caught(data: UInt8Array, data_id: int) -> None:
    protected = protect(data, data_id, np.array([7]))
    flips = np.packbits(np.eye(64, dtype=np.uint8), axis=1)
    remainder = data_id_remainder(data_id)
    assert crc_is_valid(protected, remainder).all()
    assert not crc_is_valid(protected ^ flips, remainder).any()
