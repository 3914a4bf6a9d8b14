"""The outbox against a broker in memory: order, marks, absence, return, and a bounded goodbye."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, closing
from dataclasses import replace

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from clutch_results.records import shift_record
from diag_service.delivery import Acknowledge, DeliveryLimits, Outbox
from diag_service.errors import PublishError
from diag_service.store import ResultStore
from fleet_contract import Outcome, Receipt, key_of, schema
from tests.support.builders import shift_result
from tests.support.memory_link import MemoryLink
from tests.support.outboxes import STATE, until
from tests.support.shiftings import scattered

QUICK = DeliveryLimits(first_pause_s=0.001)


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


def put(store: ResultStore, *seqs: int) -> None:
    for seq in seqs:
        store.add(shift_result(seq), STATE)


def seqs(link: MemoryLink) -> list[int]:
    return [result.seq for result in link.results]


async def test_a_broken_connection_loses_nothing(store: ResultStore) -> None:
    first, second = MemoryLink(), MemoryLink()
    outbox = Outbox(store, "car1", Broker(first, second).connect, "broker", limits=replace(QUICK, settled_after_s=0.0))
    put(store, 1)
    sender = asyncio.create_task(outbox.run())
    await until(lambda: store.unpublished_count("car1") == 0)
    first.cut.set()
    put(store, 2)
    outbox.wake()
    await until(lambda: seqs(second) == [2])
    assert [state["seq"] for state in second.states] == [2]  # a restarted broker hears the state again
    await outbox.close(sender)
    assert seqs(first) == [1]


async def test_states_tell_what_ended_last_of_what_was_made_like_the_last(store: ResultStore) -> None:
    link = MemoryLink()
    outbox = Outbox(store, "car1", Broker(link).connect, "broker", limits=QUICK)
    for one in (shift_result(5), shift_result(6, to_gear=3), shift_result(1, stream="an older log")):
        store.add(one, STATE)
    sender = asyncio.create_task(outbox.run())
    await until(lambda: store.unpublished_count("car1") == 0)
    assert {state["seq"] for state in link.states} == {5, 6}
    store.add(replace(shift_result(2, stream="an older log"), calibration_version="another"), STATE)
    assert await outbox.close(sender) == 0
    told = link.states[-1]
    assert (told["seq"], told["calibration_version"]) == (2, "another")
    assert "Clutch 1: no event engaged it yet." in str(told["order"])  # by that calibration


async def test_the_states_of_a_vehicle_without_friction_say_how_it_shifts(store: ResultStore) -> None:
    link = MemoryLink()
    outbox = Outbox(store, "car1", Broker(link).connect, "broker", limits=QUICK)
    for result in scattered(np.random.default_rng(5), [0, 1, 2, 90, 91, 92], 12, growth=0.3, among=0.01):
        store.add(result, STATE)
    sender = asyncio.create_task(outbox.run())
    await until(lambda: store.unpublished_count("car1") == 0)
    assert await outbox.close(sender) == 0
    told = link.states[-1]
    Draft202012Validator(schema("clutch")).validate(told)
    assert told["order"] == "There is no verdict on the fluid: friction cannot be known from this car."
    shifting = str(told["shifting"])
    assert shifting.startswith("Friction: cannot be known from this car; shifting: 72 events in 6 drives; power on")
    assert "% longer than in March" in shifting


async def test_a_state_with_friction_says_nothing_of_shifting(store: ResultStore) -> None:
    link = MemoryLink()
    outbox = Outbox(store, "car1", Broker(link).connect, "broker", limits=QUICK)
    put(store, 1)
    sender = asyncio.create_task(outbox.run())
    await until(lambda: store.unpublished_count("car1") == 0)
    assert await outbox.close(sender) == 0
    assert "shifting" not in link.states[-1]


async def test_what_was_acknowledged_just_before_the_connection_broke_is_sent_again(store: ResultStore) -> None:
    first, second, third = MemoryLink(), MemoryLink(), MemoryLink()
    outbox = Outbox(store, "car1", Broker(first, second, third).connect, "broker", limits=QUICK)
    put(store, 1, 2)
    sender = asyncio.create_task(outbox.run())
    await until(lambda: seqs(first) == [1, 2] and store.unpublished_count("car1") == 0)
    first.cut.set()
    await until(lambda: seqs(second) == [1, 2])
    second.cut.set()
    await until(lambda: seqs(third) == [1, 2])
    put(store, 3)
    outbox.wake()
    await until(lambda: seqs(third) == [1, 2, 3])
    await outbox.close(sender)


# --- with a backend whose word counts ---


def backend_outbox(store: ResultStore, broker: Broker, limits: DeliveryLimits = QUICK) -> Outbox:
    return Outbox(store, "car1", broker.connect, "broker", acknowledge=Acknowledge.BACKEND, limits=limits)


def receipts(*seqs: int, outcome: Outcome = Outcome.ACCEPTED, reason: str | None = None) -> list[Receipt]:
    return [Receipt(key=key_of(shift_record(shift_result(seq))), outcome=outcome, reason=reason) for seq in seqs]


async def test_silence_is_told_once_and_results_are_sent_again_less_and_less_often(
    store: ResultStore, caplog: pytest.LogCaptureFixture
) -> None:
    link = MemoryLink()
    outbox = backend_outbox(store, Broker(link), replace(QUICK, resend_after_s=0.05))
    put(store, 1, 2)
    began_s = asyncio.get_running_loop().time()
    sender = asyncio.create_task(outbox.run())
    await until(lambda: seqs(link)[:8] == [1, 2] * 4)
    assert asyncio.get_running_loop().time() - began_s >= 0.05 + 0.05 + 0.1
    assert caplog.text.count("no backend acknowledged 2 results") == 1
    assert link.on_receipts is not None
    link.on_receipts(receipts(1, 2))
    assert await outbox.close(sender) == 0
    assert outbox.counts.repeated >= 6


async def test_a_silent_backend_is_asked_with_a_few_and_gets_the_others_when_it_answers(store: ResultStore) -> None:
    link = MemoryLink()
    outbox = backend_outbox(store, Broker(link), replace(QUICK, resend_after_s=0.02, probe_count=2))
    put(store, *range(1, 11))
    sender = asyncio.create_task(outbox.run())
    await until(lambda: len(link.results) == 16)  # all once, and three questions
    asked = set(seqs(link)[10:])
    assert len(asked) == 6
    link.is_acknowledging = True
    await until(lambda: store.unpublished_count("car1") == 0)
    assert await outbox.close(sender) == 0


async def test_a_quarantined_result_is_forgotten_and_told(store: ResultStore, caplog: pytest.LogCaptureFixture) -> None:
    link = MemoryLink()
    outbox = backend_outbox(store, Broker(link))
    put(store, 1)
    sender = asyncio.create_task(outbox.run())
    await until(lambda: seqs(link) == [1])
    assert link.on_receipts is not None
    link.on_receipts(receipts(1, outcome=Outcome.QUARANTINED, reason="quality: must be at most 1"))
    assert await outbox.close(sender) == 0
    assert "put aside 1 results" in caplog.text
    assert "quality: must be at most 1" in caplog.text


async def test_a_silent_backend_gets_no_more_than_a_window_and_what_happens_now(store: ResultStore) -> None:
    link = MemoryLink()
    outbox = backend_outbox(store, Broker(link), replace(QUICK, window_count=20))
    put(store, *range(1, 101))
    sender = asyncio.create_task(outbox.run())
    await until(lambda: len(link.results) == 20)
    put(store, 101)
    outbox.wake()
    await until(lambda: seqs(link)[20:] == [101])
    assert await outbox.close(sender, timeout_s=0.05) == 101


async def test_what_a_dying_worker_took_with_it_is_sent_again(store: ResultStore) -> None:
    link = MemoryLink()
    outbox = backend_outbox(store, Broker(link), replace(QUICK, resend_after_s=0.01))
    put(store, 1, 2)
    sender = asyncio.create_task(outbox.run())
    await until(lambda: 2 in seqs(link) and link.on_receipts is not None)
    assert link.on_receipts is not None
    link.on_receipts(receipts(2))
    count = seqs(link).count(1)
    await until(lambda: seqs(link).count(1) > count)
    link.on_receipts(receipts(1))
    assert await outbox.close(sender) == 0
