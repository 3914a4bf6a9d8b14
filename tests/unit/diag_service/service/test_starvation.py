"""A listener that raises, blocks or dies costs the others nothing; python-can's asyncio path fails each of these.

Its issues 1865 and 907 (a reader that died leaves its consumer waiting for ever) and 1912 (one listener's error is the
end of all) are what the tests here are about, on this service's own path.
"""

import threading
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager, closing
from typing import Any

import pytest

from clutch_results.records import ShiftResult
from diag_service.delivery import DeliveryLimits, DetachedReporter, MemoryReporter, News, Outbox
from diag_service.errors import PublishError
from diag_service.store import ResultStore
from fleet_contract import Outgoing
from tests.support.memory_link import MemoryLink
from tests.unit.diag_service.service.test_live import ListSource, cut, gear_frames, run, session_for

SHIFTS = 5
QUICK = DeliveryLimits(first_pause_s=0.01, restart_pause_s=0.01)


class RaisingReporter(MemoryReporter):
    """Raises over every second result."""

    def report(self, news: News) -> None:
        if isinstance(news, ShiftResult) and news.seq % 2 == 0:
            raise RuntimeError("no")
        super().report(news)


class BlockingReporter(MemoryReporter):
    """Does not return from the first result until it is let go."""

    def __init__(self) -> None:
        super().__init__()
        self.let_go = threading.Event()

    def report(self, news: News) -> None:
        if isinstance(news, ShiftResult):
            self.let_go.wait()
        super().report(news)


@pytest.fixture(name="store")
def _store() -> Iterator[ResultStore]:
    with closing(ResultStore.in_memory()) as store:
        yield store


def linked(link: Any, store: ResultStore) -> Outbox:  # noqa: ANN401 - whatever stands in for a link
    @asynccontextmanager
    async def connect() -> AsyncIterator[Any]:
        yield link

    return Outbox(store, "car1", connect, "memory", limits=QUICK)


async def test_a_reporter_that_raises_costs_what_it_was_told(store: ResultStore) -> None:
    raising, link = RaisingReporter(), MemoryLink()
    reporter = DetachedReporter(raising)
    await run(ListSource(cut(gear_frames(SHIFTS), 50)), session_for(store, reporter), outbox=linked(link, store))
    assert [result.seq for result in store.results("car1")] == [1, 2, 3, 4, 5]
    assert sorted(result.seq for result in link.results) == [1, 2, 3, 4, 5]
    assert [result.seq for result in raising.results] == [1, 3, 5]
    assert len(raising.summaries) == 1
    assert (reporter.failed, reporter.dropped) == (2, 0)


async def test_a_reporter_that_blocks_holds_up_nobody(store: ResultStore, caplog: pytest.LogCaptureFixture) -> None:
    blocking, link = BlockingReporter(), MemoryLink()
    reporter = DetachedReporter(blocking, limit=2, drain_s=0.05)
    await run(ListSource(cut(gear_frames(SHIFTS), 50)), session_for(store, reporter), outbox=linked(link, store))
    assert sorted(result.seq for result in link.results) == [1, 2, 3, 4, 5]
    assert reporter.dropped >= 2
    assert "does not accept them" in caplog.text
    blocking.let_go.set()


class FailingLink(MemoryLink):
    """Fails in its own way over the first messages it is given, then works."""

    def __init__(self, error: Exception) -> None:
        super().__init__()
        self._error: Exception | None = error

    async def send(self, messages: Sequence[Outgoing]) -> None:
        if self._error is not None and messages:
            error, self._error = self._error, None
            raise error
        await super().send(messages)


@pytest.mark.parametrize("error", [PublishError("away"), RuntimeError("a defect"), TimeoutError("slow")])
async def test_a_publisher_that_dies_is_started_again(store: ResultStore, error: Exception) -> None:
    reporter, link = MemoryReporter(), FailingLink(error)
    await run(ListSource(cut(gear_frames(SHIFTS), 50)), session_for(store, reporter), outbox=linked(link, store))
    assert [result.seq for result in reporter.results] == [1, 2, 3, 4, 5]
    assert {result.seq for result in link.results} == {1, 2, 3, 4, 5}
    assert reporter.summaries[0].unpublished_count == 0
