"""A live bus: its state, and its queue of frames."""

import asyncio
import threading

import numpy as np
import pytest

from canlog.errors import SourceError
from canlog.frames import ERROR_FLAG, BusTrouble, FrameBatch
from canlog.live.sources import FrameQueue
from canlog.live.supervisor import TROUBLE_S, BusState, BusWatch
from tests.support.batches import frames_at
from tests.support.patience import HANG_S
from tests.support.traffic import as_received, assert_same, random_frames

DATA, BUS_OFF, RESTART, ARBITRATION = 0x123, ERROR_FLAG | 0x40, ERROR_FLAG | 0x100, ERROR_FLAG | 0x2


def heard(*can_ids: int) -> FrameBatch:
    return frames_at(range(len(can_ids)), can_ids)


def test_an_error_degrades_the_bus_for_a_while() -> None:
    watch = BusWatch()
    watch.add_frames(heard(DATA, ARBITRATION, DATA), 0, 10.0)
    assert watch.status(10.0 + 0.9 * TROUBLE_S).state is BusState.DEGRADED
    assert watch.status(10.0 + TROUBLE_S).state is BusState.UP
    assert watch.status(99.0).errors == {BusTrouble.ARBITRATION_LOST: 1}


def test_bus_off_lasts_until_a_restart_and_that_until_a_frame() -> None:
    watch = BusWatch()
    states = []
    for batch in (heard(DATA, BUS_OFF), heard(ARBITRATION), heard(RESTART), heard(DATA)):
        watch.add_frames(batch, 0, 0.0)
        states.append(watch.status(2 * TROUBLE_S).state)
    assert states == [BusState.BUS_OFF, BusState.BUS_OFF, BusState.RESTARTED, BusState.UP]
    assert watch.status(0.0).last_problem == "the controller went bus-off"


def test_an_interface_that_goes_and_comes() -> None:
    watch = BusWatch()
    watch.mark_lost("gone")
    assert watch.status(0.0).state is BusState.DOWN
    watch.mark_back()
    assert watch.status(0.0).state is BusState.RESTARTED
    watch.add_frames(heard(DATA), 0, 1.0)
    status = watch.status(1.0)
    assert (status.state, status.interruption_count, status.last_problem) == (BusState.UP, 1, "gone")


def batches(count: int, sizes: int = 10) -> tuple[FrameBatch, list[FrameBatch]]:
    whole = as_received(random_frames(count))
    return whole, [whole[first : first + sizes] for first in range(0, count, sizes)]


async def test_what_does_not_fit_is_dropped_newest_first_and_counted() -> None:
    whole, parts = batches(100)
    queue = FrameQueue(limit=45, linger_s=0.0)
    for part in parts:
        queue.offer(part)
    assert queue.dropped == 55
    taken = await queue.next_batch()
    assert taken is not None
    assert_same(taken, whole[:45])
    queue.offer(parts[0])
    taken = await queue.next_batch()
    assert taken is not None
    assert_same(taken, parts[0])
    assert queue.dropped == 55


async def test_an_error_comes_after_the_frames_and_the_first_one_counts() -> None:
    _, parts = batches(10)
    queue = FrameQueue()
    queue.offer(parts[0])
    queue.close(SourceError("went down"))
    queue.close(SourceError("later"))
    assert await queue.next_batch() is not None
    with pytest.raises(SourceError, match="went down"):
        await queue.next_batch()


async def test_a_thread_loses_nothing() -> None:
    whole, parts = batches(5_000)
    queue = FrameQueue(linger_s=0.0)

    def produce() -> None:
        for part in parts:
            queue.offer(part)
        queue.close()

    producer = threading.Thread(target=produce)
    producer.start()
    taken = []
    while (batch := await asyncio.wait_for(queue.next_batch(), timeout=HANG_S)) is not None:
        taken.append(batch)
    producer.join()
    assert queue.dropped == 0
    assert_same([batch for batch in taken if len(batch)], whole)
    assert np.all(whole.length <= 8)
