"""A frame that cannot be believed reaches no estimate: the drive ends as if the frame had never been sent.

Every message of the wire contract gets every fault while a clutch slips: a wrong CRC, a counter that is stuck, one that
jumps, a payload that is cut short, values that are not available. What the frames carry instead of the truth is
plausible: the same values in frames that protect themselves properly do change the estimate.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from canlog.arrays import Int64Array, UInt8Array
from canlog.e2e.profile1 import COUNTER_PERIOD, counter_of, protect
from canlog.frames import FrameBatch
from clutch_results.records import Status
from diag_service.mapping.profile import load_profile
from ecu_emulator.drive.build import ROAD_MESSAGES
from tests.support.chain import Outcome, diagnosed, frames_of_log
from tests.support.wire import CONTRACTS

DURATION_S = 10.0  # three shifts
SHIFT = 1  # the one that suffers, counted from 0
FOLLOWED = sorted(
    {source.message_name for source in load_profile().sources.values()} - ROAD_MESSAGES
)  # of the shift cycle
ESTIMATED_FROM = ("ECM_TorqueSpeed", "TCU_InputSpeeds", "TCU_Pressures")


@cache
def clean_frames(log: Path) -> FrameBatch:
    return frames_of_log(log, DURATION_S)


@cache
def clean_outcome(log: Path) -> Outcome:
    return diagnosed([clean_frames(log)])


def victims(log: Path, name: str) -> Int64Array:
    """Return up to three frames of a message inside the shift, far enough apart to be faults of their own."""
    estimate = clean_outcome(log).diagnoses[SHIFT].estimate
    batch = clean_frames(log)
    is_inside = (batch.t_ns > estimate.start_ns + 50_000_000) & (batch.t_ns < estimate.end_ns)
    rows = np.flatnonzero(is_inside & (batch.can_id == CONTRACTS[name].can_id))
    return rows[:: max(10, rows.size // 3)][:3]


def lies(log: Path, name: str, rows: Int64Array) -> UInt8Array:
    """Return what other frames of the message said five seconds later, counters as the frames in ``rows`` have them."""
    batch = clean_frames(log)
    same = np.flatnonzero(batch.can_id == CONTRACTS[name].can_id)
    later = same[np.minimum(np.searchsorted(batch.t_ns[same], batch.t_ns[rows] + 5_000_000_000), same.size - 1)]
    return protected(name, batch.data[later], counter_of(batch.data[rows]))


def protected(name: str, data: UInt8Array, counter: UInt8Array) -> UInt8Array:
    data_id = CONTRACTS[name].data_id
    assert data_id is not None
    return protect(data, data_id, counter.astype(np.int64))


def with_payloads(batch: FrameBatch, rows: Int64Array, payloads: UInt8Array) -> FrameBatch:
    data = batch.data.copy()
    data[rows] = payloads
    return replace(batch, data=data)


def without(batch: FrameBatch, rows: Int64Array) -> FrameBatch:
    is_kept = np.ones(len(batch), np.bool_)
    is_kept[rows] = False
    return batch[is_kept]


@cache
def outcome_without(log: Path, name: str) -> Outcome:
    """Return what is diagnosed if the victims had never been sent."""
    return diagnosed([without(clean_frames(log), victims(log, name))])


def bad_crc(log: Path, name: str, rows: Int64Array) -> FrameBatch:
    payloads = lies(log, name, rows)
    payloads[:, 0] ^= 0x01
    return with_payloads(clean_frames(log), rows, payloads)


def stuck_counter(log: Path, name: str, rows: Int64Array) -> FrameBatch:
    before = counter_of(clean_frames(log).data[rows]).astype(np.int64) - 1
    payloads = protected(name, lies(log, name, rows), (before % COUNTER_PERIOD).astype(np.uint8))
    return with_payloads(clean_frames(log), rows, payloads)


def jumping_counter(log: Path, name: str, rows: Int64Array) -> FrameBatch:
    far = counter_of(clean_frames(log).data[rows]).astype(np.int64) + 7
    payloads = protected(name, lies(log, name, rows), (far % COUNTER_PERIOD).astype(np.uint8))
    return with_payloads(clean_frames(log), rows, payloads)


def short_frame(log: Path, name: str, rows: Int64Array) -> FrameBatch:
    payloads = lies(log, name, rows)
    payloads[:, 7:] = 0
    length = clean_frames(log).length.copy()
    length[rows] = 7
    return replace(with_payloads(clean_frames(log), rows, payloads), length=length)


def told(outcome: Outcome) -> list[tuple[object, ...]]:
    """Return all but the quality, which knows a frame that came to harm at its own time and a lost one by the next."""
    return [
        (replace(estimate, fit=replace(estimate.fit, quality=0.0)), *others)
        for estimate, *others in outcome.fingerprint
    ]


FAULTS: dict[str, Callable[[Path, str, Int64Array], FrameBatch]] = {
    "bad_crc": bad_crc,
    "repeated": stuck_counter,
    "wrong_sequence": jumping_counter,
    "short": short_frame,
}


@pytest.mark.parametrize("reason", FAULTS)
@pytest.mark.parametrize("name", FOLLOWED)
def test_a_bad_frame_counts_and_is_as_good_as_none(drive_log: Path, name: str, reason: str) -> None:
    rows = victims(drive_log, name)
    assert rows.size
    absent = outcome_without(drive_log, name)
    spoilt = diagnosed([FAULTS[reason](drive_log, name, rows)])
    assert told(spoilt) == told(absent)
    assert spoilt.diagnoses[SHIFT].estimate.fit.quality <= absent.diagnoses[SHIFT].estimate.fit.quality
    assert spoilt.counts.rejected == {reason: rows.size}
    assert spoilt.counts.missing == 0
    assert absent.counts.missing == rows.size
    assert spoilt.counts.decoded == absent.counts.decoded
    assert spoilt.counts.on_bus == len(clean_frames(drive_log))
    assert spoilt.counts.is_balanced


@pytest.mark.parametrize("name", FOLLOWED)
def test_values_that_are_not_available_are_as_good_as_none(drive_log: Path, name: str) -> None:
    rows = victims(drive_log, name)
    payloads = np.full((rows.size, 8), 0xFF, np.uint8)  # the highest raw value of every signal
    counter = counter_of(clean_frames(drive_log).data[rows])
    spoilt = diagnosed([with_payloads(clean_frames(drive_log), rows, protected(name, payloads, counter))])
    absent = outcome_without(drive_log, name)
    assert told(spoilt) == told(absent)
    assert spoilt.counts.rejected == {}
    assert spoilt.counts.missing == 0
    assert spoilt.counts.decoded == len(clean_frames(drive_log))
    assert spoilt.counts.invalid_values - absent.counts.invalid_values >= rows.size


@pytest.mark.parametrize("name", ESTIMATED_FROM)
def test_the_same_values_in_good_frames_would_change_the_estimate(drive_log: Path, name: str) -> None:
    """Without this, the tests above would prove little."""
    rows = victims(drive_log, name)
    believed = diagnosed([with_payloads(clean_frames(drive_log), rows, lies(drive_log, name, rows))])
    truthful = clean_outcome(drive_log).diagnoses[SHIFT].estimate
    assert truthful.status is Status.VALID
    assert believed.diagnoses[SHIFT].estimate != truthful
    assert not any(believed.counts.rejected.values())


@pytest.mark.parametrize("name", ESTIMATED_FROM)
def test_a_controller_that_hangs_through_a_whole_shift_costs_that_shift_only(drive_log: Path, name: str) -> None:
    """It repeats its last frame, counter and all: nothing is learnt from it, and the shift says so."""
    batch = clean_frames(drive_log)
    truthful = [diagnosis.estimate for diagnosis in clean_outcome(drive_log).diagnoses]
    rows = np.flatnonzero(
        (batch.t_ns > truthful[SHIFT].start_ns)
        & (batch.t_ns < truthful[SHIFT].end_ns)
        & (batch.can_id == CONTRACTS[name].can_id)
    )
    hung = diagnosed([with_payloads(batch, rows[1:], batch.data[rows[0]])])
    assert hung.counts.rejected == {"repeated": rows.size - 1}
    estimates = [diagnosis.estimate for diagnosis in hung.diagnoses]
    assert [estimate.status for estimate in estimates] == [Status.VALID, Status.REJECTED, Status.VALID]
    assert estimates[SHIFT].friction is None
    assert estimates[SHIFT].reasons
    assert estimates[0] == truthful[0]
