"""The queue between receiver and service: nothing is lost in silence, nothing waits for ever."""

import asyncio
import threading

import numpy as np
import pytest

from canlog.errors import SourceError
from canlog.frames import FrameBatch
from canlog.live.sources import FrameQueue
from tests.support.patience import HANG_S
from tests.support.traffic import as_received, assert_same, random_frames


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
