"""When the outbox tries again, and when it tells its numbers; on a clock that waits for nothing."""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, closing, suppress
from typing import ParamSpec, TypeVar

import pytest

from diag_service.delivery import Acknowledge, DeliveryLimits, Outbox
from diag_service.errors import PublishError
from diag_service.store import ResultStore
from fleet_contract import Outgoing, metrics_message
from tests.support.memory_link import MemoryLink
from tests.support.outboxes import NOW, put
from tests.support.virtual_time import in_virtual_time

P = ParamSpec("P")
T = TypeVar("T")
LIMITS = DeliveryLimits(first_pause_s=0.5, longest_pause_s=600.0)


@pytest.fixture(autouse=True)
def _without_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    async def call(function: Callable[P, T], *arguments: P.args, **named: P.kwargs) -> T:
        return function(*arguments, **named)

    monkeypatch.setattr(asyncio, "to_thread", call)


class Broker:
    """Refuses a connection (None), or breaks it after some seconds; in the end it cannot be reached any more."""

    def __init__(self, *lasts_s: float | None) -> None:
        self.lasts_s = list(lasts_s)
        self.tried_s: list[float] = []
        self.ended_s: list[float] = []
        self.links: list[MemoryLink] = []
        self.has_ended = asyncio.Event()

    @asynccontextmanager
    async def connect(self) -> AsyncIterator[MemoryLink]:
        loop = asyncio.get_running_loop()
        self.tried_s.append(loop.time())
        try:
            if not self.lasts_s:
                self.has_ended.set()
                await asyncio.Event().wait()
            if (lasts_s := self.lasts_s.pop(0)) is None:
                raise PublishError("connection refused")
            self.links.append(MemoryLink())
            loop.call_later(lasts_s, self.links[-1].cut.set)
            yield self.links[-1]
        finally:
            self.ended_s.append(loop.time())


@pytest.fixture(name="store")
def _store() -> Iterator[ResultStore]:
    with closing(ResultStore.in_memory()) as store:
        yield store


async def pauses_s(store: ResultStore, *lasts_s: float | None) -> Sequence[float]:
    """Return how long the outbox waits after each connection."""
    broker = Broker(*lasts_s)
    sender = asyncio.create_task(Outbox(store, "car1", broker.connect, "broker", limits=LIMITS).run())
    await broker.has_ended.wait()
    sender.cancel()
    with suppress(asyncio.CancelledError):
        await sender
    return [tried - ended for ended, tried in zip(broker.ended_s, broker.tried_s[1:], strict=False)]


@in_virtual_time
async def test_each_failure_doubles_the_pause_up_to_a_limit_and_chance_spreads_it(store: ResultStore) -> None:
    pauses = await pauses_s(store, *[None] * 40)
    shares = [pause / min(600.0, 0.5 * 2.0 ** min(count, 10)) for count, pause in enumerate(pauses)]
    assert all(0.5 <= share <= 1.0 for share in shares)
    assert min(shares) < 0.6
    assert max(shares) > 0.9


@pytest.mark.parametrize(("lasted_s", "is_forgotten"), [(599.0, False), (601.0, True)])
def test_failures_are_forgotten_once_a_connection_lasts_longer_than_the_longest_pause(
    store: ResultStore, lasted_s: float, is_forgotten: bool
) -> None:
    @in_virtual_time
    async def drive() -> None:
        pauses = await pauses_s(store, *[None] * 6, lasted_s, None)
        assert (pauses[6] <= 0.5, pauses[7] <= 1.0) == (is_forgotten, is_forgotten)

    drive()


@in_virtual_time
async def test_failures_are_forgotten_once_results_arrive(store: ResultStore) -> None:
    put(store, [1, 2])
    *_, pause = await pauses_s(store, *[None] * 6, 1.0)
    assert pause <= 0.5


@in_virtual_time
async def test_numbers_are_told_at_once_and_each_minute_whatever_connection_there_is(store: ResultStore) -> None:
    broker, told = Broker(90.0, 500.0), list[tuple[float, float]]()
    put(store, [1, 2])

    def message(numbers: Mapping[str, float]) -> Outgoing:
        told.append((asyncio.get_running_loop().time(), numbers["outbox_sent_count"]))
        return metrics_message("car1", NOW, numbers)

    outbox = Outbox(store, "car1", broker.connect, "broker", metrics=message, limits=LIMITS)
    sender = asyncio.create_task(outbox.run())
    await asyncio.sleep(250.0)
    assert [time_s for time_s, _ in told] == pytest.approx([0.0, 60.0, 120.0, 180.0, 240.0])
    assert [count for _, count in told] == [2, 2, 2, 2, 2]
    assert await outbox.close(sender) == 0


@in_virtual_time
async def test_a_broker_that_takes_results_again_is_told_once(
    store: ResultStore, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "diag_service")
    broker = Broker(None, None, 50.0, 50.0)
    put(store, [1, 2])
    outbox = Outbox(store, "car1", broker.connect, "broker", limits=LIMITS)
    sender = asyncio.create_task(outbox.run())
    await asyncio.sleep(40.0)
    assert [record.getMessage() for record in caplog.records] == [
        "broker broker: connection refused; 2 results wait in the store, trying again",
        "broker broker takes results again",
    ]
    put(store, [3])
    outbox.wake()
    await asyncio.sleep(1.0)
    assert await outbox.close(sender) == 0
    assert len(caplog.records) == 2


@pytest.mark.parametrize(
    ("acknowledge", "is_heard", "is_told"),
    [(Acknowledge.BACKEND, False, True), (Acknowledge.BACKEND, True, False), (Acknowledge.BROKER, False, False)],
)
def test_a_fleet_that_does_not_answer_is_told_if_its_word_counts(
    store: ResultStore, acknowledge: Acknowledge, is_heard: bool, is_told: bool, caplog: pytest.LogCaptureFixture
) -> None:
    limits = DeliveryLimits(answer_s=0.001)
    outbox = Outbox(store, "car1", Broker().connect, "broker", acknowledge=acknowledge, limits=limits)
    if is_heard:
        outbox._state.fleet_is_heard.set()
    outbox.await_fleet()
    assert ("did not tell its fluid fills" in caplog.text) == is_told
    caplog.clear()
    outbox.await_fleet()  # once
    assert not caplog.text
