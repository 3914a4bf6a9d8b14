"""Cutting the stream at any place changes no event and no bit of any estimate, verdict or state."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from canlog.frames import FrameBatch
from clutch_results.records import Status
from ecu_emulator.drive.recording import Drive
from ecu_emulator.scenario.scenario import Effects
from tests.support.builders import drive_scenario
from tests.support.chain import DRIVE_S, diagnosed, drive_frames, whole_drive
from tests.support.lateness import sent_by_a_slow_machine
from tests.support.wire import received

FRAME_COUNT = 6_000  # or some more: cuts beyond the end fall together there


@cache
def slow_frames() -> FrameBatch:
    scenario = replace(drive_scenario("ideal"), effects=Effects(least_cycle_ms=20))
    return received(next(Drive(scenario).stretches(DRIVE_S)).frames)


def cut(batch: FrameBatch, places: list[int]) -> list[FrameBatch]:
    edges = [0, *sorted(min(place, len(batch)) for place in places), len(batch)]
    return [batch[start:stop] for start, stop in pairwise(edges)]


def test_the_drive_is_worth_cutting() -> None:
    assert len(drive_frames()) >= FRAME_COUNT
    assert [diagnosis.estimate.status for diagnosis in whole_drive().diagnoses] == [Status.VALID] * 3


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, FRAME_COUNT), min_size=1, max_size=60))
@example(list(range(0, FRAME_COUNT, 40)))  # as a live bus hands them over
@example(list(range(700, 1_900)))  # frame by frame through a shift, its beginning and its end
def test_cutting_the_frames_anywhere_changes_nothing(places: list[int]) -> None:
    pieces = diagnosed(cut(drive_frames(), places))
    assert pieces.fingerprint == whole_drive().fingerprint
    assert pieces.counts == whole_drive().counts


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_damaged_frames_cut_anywhere_change_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    batch = drive_frames()
    data = batch.data.copy()
    hit = rng.choice(len(batch), 30, replace=False)
    data[hit, rng.integers(0, 8, hit.size)] ^= np.uint8(0x5A)
    damaged = FrameBatch(t_ns=batch.t_ns, can_id=batch.can_id, length=batch.length, data=data)
    places = np.concatenate((hit, rng.integers(0, len(batch), 30))).tolist()
    one, many = diagnosed([damaged]), diagnosed(cut(damaged, places))
    assert many.fingerprint == one.fingerprint
    assert many.counts == one.counts
    assert many.counts.rejected == {"bad_crc": hit.size}


@settings(max_examples=4, deadline=None)
@given(st.lists(st.integers(0, FRAME_COUNT), min_size=1, max_size=60))
@example(list(range(0, FRAME_COUNT, 40)))
def test_a_slower_bus_is_held_against_its_own_cycle_wherever_it_is_cut(places: list[int]) -> None:
    one, pieces = diagnosed([slow_frames()]), diagnosed(cut(slow_frames(), places))
    assert [diagnosis.estimate.status for diagnosis in one.diagnoses] == [Status.VALID] * 3
    assert pieces.fingerprint == one.fingerprint
    assert pieces.counts == one.counts


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(15, 600))
def test_what_a_slow_machine_sent_is_the_same_wherever_it_is_cut(seed: int, step: int) -> None:
    batch = sent_by_a_slow_machine(drive_frames(), seed)
    one, pieces = diagnosed([batch]), diagnosed(cut(batch, list(range(0, len(batch), step))))
    assert pieces.fingerprint == one.fingerprint
    assert pieces.counts == one.counts
