"""Results that waited together travel together where the backend takes that; where it does not work they go alone."""

import asyncio
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager, closing

import pytest

from clutch_results.records import shift_record
from diag_service.delivery import Acknowledge, DeliveryLimits, Outbox
from diag_service.errors import PublishError, PublishRefusedError
from diag_service.store import ResultStore
from fleet_contract import MAX_BUNDLED, Outgoing, Receipt, key_of
from tests.support.builders import shift_result
from tests.support.memory_link import MemoryLink
from tests.support.outboxes import put, until
from tests.support.patience import HANG_S

QUICK = DeliveryLimits(first_pause_s=0.001, resend_after_s=0.05, probe_count=2)
COUNT = 450


class Place:
    """Where every connection leads to one link after the other, the last of them again and again."""

    def __init__(self, *links: MemoryLink) -> None:
        self.links = list(links)
        self.count = 0

    @asynccontextmanager
    async def connect(self) -> AsyncIterator[MemoryLink]:
        self.count += 1
        yield self.links[min(self.count, len(self.links)) - 1]


class Deaf(MemoryLink):
    """A broker behind which nobody hears bundles."""

    async def send(self, messages: Sequence[Outgoing]) -> None:
        """Keep what is no bundle."""
        await super().send([message for message in messages if not is_bundle(message)])
        self.bundled += [1 for message in messages if is_bundle(message)]


class Refusing(MemoryLink):
    """A broker that never takes a bundle, and may hang up."""

    def __init__(self, *, hangs_up: bool) -> None:
        super().__init__(is_acknowledging=True, takes_bundles=True)
        self.hangs_up = hangs_up
        self.refused_count = 0

    async def send(self, messages: Sequence[Outgoing]) -> None:
        """Keep what comes before the first bundle."""
        for message in messages:
            if is_bundle(message):
                self.refused_count += 1
                raise PublishError("connection lost") if self.hangs_up else PublishRefusedError("Not authorized")
            await super().send([message])


def is_bundle(message: Outgoing) -> bool:
    return message.topic.endswith("/bundle")


@pytest.fixture(name="store")
def _store() -> Iterator[ResultStore]:
    with closing(ResultStore.in_memory()) as store:
        yield store


async def drained(store: ResultStore, place: Place, kind: Acknowledge = Acknowledge.BACKEND) -> Outbox:
    """Return an outbox that has delivered everything."""
    outbox = Outbox(store, "car1", place.connect, "broker", acknowledge=kind, limits=QUICK)
    sender = asyncio.create_task(outbox.run())
    await until(lambda: store.unpublished_count("car1") == 0, HANG_S)
    assert await outbox.close(sender) == 0
    return outbox


def seqs(link: MemoryLink) -> list[int]:
    return [result.seq for result in link.results]


async def test_what_happens_now_goes_beside_the_backlog_not_in_it(store: ResultStore) -> None:
    class Busy(MemoryLink):
        async def send(self, messages: Sequence[Outgoing]) -> None:
            if len(sent) == 1:  # while the first of the backlog is on its way
                store.add(shift_result(COUNT + 1), None)
            sent.append([is_bundle(message) for message in messages if "/clutch/" not in message.topic])
            await super().send(messages)

    sent: list[list[bool]] = []
    store.note_takes_bundles(is_taken=True)
    put(store, range(1, COUNT + 1))
    link = Busy(is_acknowledging=True, takes_bundles=True)
    await drained(store, Place(link))
    assert sent[2][:2] == [False, True]
    assert sorted(seqs(link)) == list(range(1, COUNT + 2))


@pytest.mark.parametrize("says_so", [False, True])
async def test_bundles_that_nobody_hears_cost_time_and_nothing_else(store: ResultStore, *, says_so: bool) -> None:
    """A backend that was set back does not say that it takes them; behind an access list of before one does."""
    store.note_takes_bundles(is_taken=True)
    put(store, range(1, COUNT + 1))
    link = Deaf(is_acknowledging=True, takes_bundles=says_so)
    await drained(store, Place(link))
    assert set(seqs(link)) == set(range(1, COUNT + 1))
    assert len(link.bundled) <= COUNT / MAX_BUNDLED
    assert store.takes_bundles() is says_so


@pytest.mark.parametrize("hangs_up", [False, True])
async def test_a_broker_that_takes_no_bundles_gets_results_alone(store: ResultStore, *, hangs_up: bool) -> None:
    store.note_takes_bundles(is_taken=True)
    put(store, range(1, COUNT + 1))
    link = Refusing(hangs_up=hangs_up)
    outbox = await drained(store, Place(link))
    assert set(seqs(link)) == set(range(1, COUNT + 1))
    assert 1 <= link.refused_count <= 3
    assert outbox.counts.failure == (link.refused_count if hangs_up else 0)


async def test_what_of_a_bundle_nobody_acknowledged_comes_again_alone(store: ResultStore) -> None:
    class Forgetful(MemoryLink):
        async def send(self, messages: Sequence[Outgoing]) -> None:
            self.is_acknowledging = not any(map(is_bundle, messages))
            await super().send(messages)
            if not self.is_acknowledging and self.on_receipts is not None:
                self.on_receipts(all_but_one, takes_bundles=True)

    all_but_one = [Receipt(key=key_of(shift_record(shift_result(seq)))) for seq in range(1, 10)]
    store.note_takes_bundles(is_taken=True)
    put(store, range(1, 11))
    link = Forgetful(takes_bundles=True)
    await drained(store, Place(link))
    assert link.bundled == [10]
    assert seqs(link)[10:] == [10]
