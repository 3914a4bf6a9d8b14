"""A bus that waits for its reader, as a simulation does: no frame is dropped, and the last come before the end."""

import asyncio
from collections import deque

import can
import pytest

from canlog.errors import BusEndedError, SourceError
from canlog.frames import FrameBatch, join
from canlog.live.pythoncan import PythonCanSource
from canlog.live.sources import FrameQueue
from tests.support.batches import frames_at
from tests.support.patience import HANG_S

FRAMES = 100_000  # half as many again as the queue holds


class Simulation(can.BusABC):
    """Gives a frame whenever it is asked, then ends."""

    waits_for_reader = True

    def __init__(self, frame_count: int) -> None:
        super().__init__(channel="nowhere")
        self._left = deque(range(frame_count))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - python-can's
        raise can.CanOperationError("who only reads sends nothing")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:  # noqa: ARG002 - python-can's
        if not self._left:
            raise can.CanOperationError("the simulation has ended")
        return can.Message(timestamp=self._left.popleft() / 1e3, arbitration_id=0x123, is_extended_id=False), False


async def test_every_frame_is_read_and_the_first_has_time_zero() -> None:
    source = PythonCanSource(Simulation(FRAMES), "a simulation")
    batches: list[FrameBatch] = []

    async def read() -> None:
        async for batch in source:
            assert isinstance(batch, FrameBatch)
            batches.append(batch)
            await asyncio.sleep(0.05)  # slower than the bus

    with pytest.raises(SourceError, match="the simulation has ended"):
        async with asyncio.timeout(HANG_S):
            await read()
    assert join(batches).t_ns.tolist() == list(range(0, FRAMES * 1_000_000, 1_000_000))
    assert (source.counts.received, source.counts.queue_dropped) == (FRAMES, 0)


class Leaving(Simulation):
    """Ends in order, at a time that may be set."""

    has_ended = True
    time_s = 100.0
    left_at_s: float | None = None

    def leave_at(self, t_s: float) -> None:
        self.left_at_s = t_s


async def read(source: PythonCanSource) -> int:
    async with asyncio.timeout(HANG_S):
        return sum([len(batch) async for batch in source if isinstance(batch, FrameBatch)])


async def test_the_regular_end_is_told_from_a_failure() -> None:
    with pytest.raises(BusEndedError, match="the simulation has ended"):
        await read(PythonCanSource(Leaving(10), "a simulation"))
    with pytest.raises(SourceError, match="cannot be read") as raised:
        await read(PythonCanSource(Simulation(10), "a simulation"))
    assert not isinstance(raised.value, BusEndedError)


async def test_a_duration_is_counted_by_a_bus_with_a_time_of_its_own() -> None:
    simulation = Leaving(10)
    assert await read(PythonCanSource(simulation, "a simulation", duration_s=100.0)) == 10
    assert simulation.left_at_s == 100.0
    with pytest.raises(BusEndedError):  # others ended it before
        await read(PythonCanSource(Leaving(10), "a simulation", duration_s=101.0))


async def test_there_is_room_until_half_of_a_queue_is_full() -> None:
    queue = FrameQueue(limit=10, linger_s=0.0)
    queue.offer(frames_at(range(5), [1] * 5))
    assert queue.wait_for_room(0.0)
    queue.offer(frames_at(range(1), [1]))
    assert not queue.wait_for_room(0.0)
    await queue.next_batch()
    assert queue.wait_for_room(0.0)
