"""What decides whether the machine gave a test the time that it claims."""

import time
from pathlib import Path
from typing import Self

import pytest

from tests.support import starvation
from tests.support.starvation import (
    NS_PER_S,
    StarvationWatch,
    again_if_starved,
    is_starved,
    stalls,
    undisturbed,
    without_cut_parts,
)

BEAT = f"{starvation.BEAT_ID}#00"


class Watch:
    """Says what it is told to."""

    def __init__(self, verdicts: list[bool]) -> None:
        self._verdicts = verdicts

    def __call__(self) -> "Watch":
        return self

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    @property
    def is_starved(self) -> bool:
        return self._verdicts.pop(0)


def test_an_outcome_that_was_not_disturbed_is_the_first_one() -> None:
    assert undisturbed(lambda number: number, lambda _: False) == 0


def test_a_machine_that_stays_busy_leaves_the_last_outcome() -> None:
    assert undisturbed(lambda number: number, lambda _: True) == starvation.TRIES - 1


async def test_a_failure_on_a_machine_that_had_time_is_a_failure_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(starvation, "StarvationWatch", Watch([False]))
    attempts = []

    @again_if_starved
    async def test() -> None:
        attempts.append(1)
        raise AssertionError

    with pytest.raises(AssertionError):
        await test()
    assert len(attempts) == 1


async def test_a_failure_on_a_machine_that_starves_the_test_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(starvation, "StarvationWatch", Watch([True, True]))
    attempts = []

    @again_if_starved
    async def test() -> None:
        attempts.append(1)
        assert len(attempts) == 3

    await test()
    assert len(attempts) == 3


def test_a_thread_that_is_woken_late_is_seen() -> None:
    with StarvationWatch() as watch:
        time.sleep(0.05)
        worst_s = watch.worst_s
    assert 0.0 < worst_s <= watch.worst_s


def test_a_pause_of_the_sender_is_a_stall_and_a_strangers_frames_hide_none(tmp_path: Path) -> None:
    log = tmp_path / "bus.log"
    times_s = ("10.000000", "10.010000", "10.100000", "10.110000")
    lines = [f"({time_s}) vcan0 {BEAT}\n" for time_s in times_s]
    log.write_text("".join([*lines[:2], "(10.050000) vcan0 7A0#11\n", *lines[2:]]))
    found = stalls(log)
    assert found == [(10_010_000_000, 10_100_000_000)]
    assert is_starved({"start_bus_ns": 10_300_000_000, "end_bus_ns": 10_900_000_000}, found)
    assert not is_starved({"start_bus_ns": 10_700_000_000, "end_bus_ns": 10_900_000_000}, found)


def test_of_a_shift_that_is_cut_in_two_the_last_part_counts() -> None:
    first, second, third = (
        {"from_gear": 1, "to_gear": 2, "start_bus_ns": 0, "end_bus_ns": NS_PER_S, "reasons": ["interrupted"]},
        {"from_gear": 1, "to_gear": 2, "start_bus_ns": 3 * NS_PER_S, "end_bus_ns": 4 * NS_PER_S, "reasons": []},
        {"from_gear": 2, "to_gear": 3, "start_bus_ns": 9 * NS_PER_S, "end_bus_ns": 10 * NS_PER_S, "reasons": []},
    )
    assert without_cut_parts([first, second, third], [(NS_PER_S, 3 * NS_PER_S)]) == [second, third]
    assert without_cut_parts([first, second, third], []) == [first, second, third]
    assert without_cut_parts([second, third], [(4 * NS_PER_S, 9 * NS_PER_S)]) == [second, third]
