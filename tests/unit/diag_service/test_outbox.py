"""The outbox against a broker in memory: order, marks, absence, return, and a bounded goodbye."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, closing

import pytest

from diag_service.errors import PublishError
from diag_service.publishers import MemoryLink, Outbox
from diag_service.records import ShiftResult
from diag_service.store import ResultStore, VehicleState, Versions
from tests.builders import shift_result

STATE = VehicleState(belief={}, condition={}, versions=Versions(algorithm="a", calibration="c"))


class Broker:
    """Lets connections in or not; each gets the next of the given links."""

    def __init__(self, *links: MemoryLink) -> None:
        self.links = list(links)
        self.is_absent = False
        self.attempt_count = 0

    @asynccontextmanager
    async def connect(self) -> AsyncIterator[MemoryLink]:
        self.attempt_count += 1
        if self.is_absent:
            raise PublishError("connection refused")
        yield self.links.pop(0)


@pytest.fixture(name="store")
def _store() -> Iterator[ResultStore]:
    with closing(ResultStore.in_memory()) as store:
        yield store


@pytest.fixture(autouse=True)
def _no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("diag_service.publishers.outbox.FIRST_PAUSE_S", 0.001)


def put(store: ResultStore, *seqs: int) -> None:
    for seq in seqs:
        store.add(shift_result(seq), STATE)


def seqs(link: MemoryLink) -> list[int]:
    return [result.seq for result in link.results]


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(5.0):
        while not condition():  # noqa: ASYNC110 - the condition lives in a database
            await asyncio.sleep(0.001)


async def test_what_waits_is_sent_in_order_then_what_comes(store: ResultStore) -> None:
    link = MemoryLink()
    outbox = Outbox(store, "car1", Broker(link).connect, "broker")
    put(store, 1, 2)
    sender = asyncio.create_task(outbox.run())
    await until(lambda: seqs(link) == [1, 2])
    put(store, 3)
    outbox.nudge()
    await until(lambda: seqs(link) == [1, 2, 3])
    assert await outbox.close(sender) == 0
    assert store.unpublished_count("car1") == 0


async def test_closing_sends_what_is_left(store: ResultStore) -> None:
    link = MemoryLink()
    outbox = Outbox(store, "car1", Broker(link).connect, "broker")
    sender = asyncio.create_task(outbox.run())
    put(store, *range(1, 251))  # more than one read of the store, and nobody said so
    assert await outbox.close(sender) == 0
    assert seqs(link) == list(range(1, 251))


async def test_a_broken_connection_loses_nothing(store: ResultStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("diag_service.publishers.outbox.SETTLE_S", 0.0)
    first, second = MemoryLink(), MemoryLink()
    outbox = Outbox(store, "car1", Broker(first, second).connect, "broker")
    put(store, 1)
    sender = asyncio.create_task(outbox.run())
    await until(lambda: store.unpublished_count("car1") == 0)
    first.cut.set()
    put(store, 2)
    outbox.nudge()
    await until(lambda: seqs(second) == [2])
    assert [result.seq for result in second.refreshed] == [1]  # a restarted broker hears the state again
    await outbox.close(sender)
    assert seqs(first) == [1]


async def test_what_was_acknowledged_just_before_the_connection_broke_is_sent_again(store: ResultStore) -> None:
    first, second, third = MemoryLink(), MemoryLink(), MemoryLink()
    outbox = Outbox(store, "car1", Broker(first, second, third).connect, "broker")
    put(store, 1, 2)
    sender = asyncio.create_task(outbox.run())
    await until(lambda: seqs(first) == [1, 2] and store.unpublished_count("car1") == 0)
    first.cut.set()
    await until(lambda: seqs(second) == [1, 2])
    second.cut.set()
    await until(lambda: seqs(third) == [1, 2])
    put(store, 3)
    outbox.nudge()
    await until(lambda: seqs(third) == [1, 2, 3])
    await outbox.close(sender)


async def test_a_loss_while_idle_is_noticed(store: ResultStore) -> None:
    first, second = MemoryLink(), MemoryLink()
    broker = Broker(first, second)
    outbox = Outbox(store, "car1", broker.connect, "broker")
    sender = asyncio.create_task(outbox.run())
    await until(lambda: broker.attempt_count == 1)
    first.cut.set()
    await until(lambda: broker.attempt_count == 2)
    await outbox.close(sender)


async def test_an_absent_broker_is_told_of_once_and_tried_again(
    store: ResultStore, caplog: pytest.LogCaptureFixture
) -> None:
    broker = Broker(link := MemoryLink())
    broker.is_absent = True
    outbox = Outbox(store, "car1", broker.connect, "broker.example")
    put(store, 1, 2, 3)
    sender = asyncio.create_task(outbox.run())
    await until(lambda: broker.attempt_count > 5)
    broker.is_absent = False
    await until(lambda: seqs(link) == [1, 2, 3])
    await outbox.close(sender)
    warnings = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert len(warnings) == 1
    assert "broker.example" in warnings[0]
    assert "3 results wait" in warnings[0]


async def test_a_refused_result_blocks_the_queue_not_the_run(store: ResultStore) -> None:
    refusing = MemoryLink()
    refusing.is_refusing = True
    broker = Broker(refusing)
    outbox = Outbox(store, "car1", broker.connect, "broker")
    put(store, 1, 2)
    sender = asyncio.create_task(outbox.run())
    await until(lambda: not broker.links)
    broker.is_absent = True
    assert await outbox.close(sender) == 2


async def test_closing_an_outbox_whose_broker_is_absent_takes_one_attempt(store: ResultStore) -> None:
    broker = Broker()
    broker.is_absent = True
    outbox = Outbox(store, "car1", broker.connect, "broker")
    put(store, 1)
    sender = asyncio.create_task(outbox.run())
    async with asyncio.timeout(2.0):
        assert await outbox.close(sender) == 1


async def test_closing_an_outbox_whose_broker_is_silent_takes_a_limited_time(store: ResultStore) -> None:
    class Silent(MemoryLink):
        async def publish(self, result: ShiftResult) -> None:
            await asyncio.Event().wait()
            await super().publish(result)

    outbox = Outbox(store, "car1", Broker(Silent()).connect, "broker")
    put(store, 1)
    sender = asyncio.create_task(outbox.run())
    async with asyncio.timeout(2.0):
        assert await outbox.close(sender, timeout_s=0.05) == 1
    assert sender.cancelled()
