"""A supervised bus: opened again after every failure, with a break in between and counts that go on."""

import asyncio
import logging
from collections.abc import AsyncIterator

import pytest

from canlog.errors import NOTICE, SourceError
from canlog.frames import ERROR_FLAG, FrameBatch
from canlog.live import BusSilence, BusState, LinkBreak, SourceCounts, SupervisedSource
from canlog.live.supervisor import Backoff
from tests.support.batches import frames_at
from tests.support.patience import HANG_S
from tests.support.virtual_time import in_virtual_time

QUICK = Backoff(retry_s=0.001, restart_s=0.01)


def numbered(*numbers: int, flags: int = 0) -> FrameBatch:
    return frames_at(numbers, 0x40 | flags)


class ShortSource:
    """A bus that gives some batches and then fails, or stays silent until it is closed."""

    def __init__(self, *batches: FrameBatch | BusSilence, failure: str | None = None) -> None:
        self._batches = batches
        self._failure = failure
        self._closed = asyncio.Event()
        self.description = "short"
        self.counts = SourceCounts(
            received=sum(len(one) for one in batches if not isinstance(one, BusSilence)), kernel_dropped=1
        )

    async def __aiter__(self) -> AsyncIterator[FrameBatch | BusSilence]:
        for batch in self._batches:
            yield batch
        if self._failure is not None:
            raise SourceError(self._failure)
        await self._closed.wait()

    async def aclose(self) -> None:
        self._closed.set()


class Script:
    """An opener that does what it was told, one step per attempt; None is an attempt that fails."""

    def __init__(self, *steps: ShortSource | None, refusal: str | None = None) -> None:
        self._steps = iter(steps)
        self._refusal = refusal
        self.restart_count = 0

    async def open(self) -> ShortSource:
        step = next(self._steps, None)
        if step is None:
            raise SourceError("still away")
        return step

    async def restart(self) -> str | None:
        self.restart_count += 1
        return self._refusal


async def parts_of(source: SupervisedSource, count: int) -> list[list[int] | str]:
    """Return the first parts: the numbers of a batch, the problem of a break, "silence"."""
    parts: list[list[int] | str] = []
    async with asyncio.timeout(HANG_S):
        async for part in source:
            if isinstance(part, BusSilence):
                parts.append("silence")
            else:
                parts.append(part.problem if isinstance(part, LinkBreak) else part.t_ns.tolist())
            if len(parts) == count:
                await source.aclose()
    return parts


async def test_it_is_opened_again_until_that_works(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(NOTICE)
    script = Script(
        None, None, ShortSource(numbered(3), failure="removed"), None, ShortSource(numbered(4), numbered(5, 6))
    )
    source = SupervisedSource(script, ShortSource(numbered(1, 2), failure="went down"), QUICK)
    assert await parts_of(source, 6) == [[1, 2], "went down", [3], "removed", [4], [5, 6]]
    assert source.counts == SourceCounts(received=6, kernel_dropped=3)
    assert source.status.interruption_count == 2
    levels = [record.levelno for record in caplog.records]
    assert levels == [logging.WARNING, NOTICE] * 2


async def test_a_bus_that_is_read_once_is_not_waited_for() -> None:
    source = SupervisedSource(Script(), ShortSource(numbered(1, 2), failure="went down"), QUICK, is_once=True)
    with pytest.raises(SourceError, match="went down"):
        await parts_of(source, 2)
    assert source.counts.received == 2


@in_virtual_time
async def test_a_controller_that_is_bus_off_is_asked_to_restart_now_and_then(caplog: pytest.LogCaptureFixture) -> None:
    script = Script(refusal="Operation not permitted")
    source = SupervisedSource(script, ShortSource(numbered(1, flags=ERROR_FLAG)), QUICK)
    iteration = asyncio.create_task(parts_of(source, 9))
    await asyncio.sleep(0.105)
    await source.aclose()
    await iteration
    assert source.status.state is BusState.BUS_OFF
    assert script.restart_count == 11  # at once, and after every 10 ms
    assert source.status.restart_count == script.restart_count
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert "not permitted" in caplog.text


@in_virtual_time
async def test_a_bus_that_opens_and_fails_at_once_is_tried_less_and_less_often() -> None:
    steps = [ShortSource(failure="no") for _ in range(30)]
    source = SupervisedSource(
        Script(*steps), ShortSource(numbered(1), failure="no"), Backoff(retry_s=0.001, longest_retry_s=0.05)
    )
    iteration = asyncio.create_task(parts_of(source, 99))
    await asyncio.sleep(0.3)
    await source.aclose()
    await iteration
    assert source.status.interruption_count == 11  # the pauses: 1, 2, 4, 8, 16, 32 ms, then 50 ms
