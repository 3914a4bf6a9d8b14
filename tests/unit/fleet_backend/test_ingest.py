"""The worker: commit, receipt, PUBACK, in this order, whatever goes wrong."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest

from diag_service.diagnosis.records import shift_record, status_record
from fleet_backend.choices import Pace
from fleet_backend.errors import BrokerError, DatabaseAwayError, RowRefusedError
from fleet_backend.ingest import FILTERS, Worker
from fleet_backend.intake import MessageKind
from fleet_backend.writer import Batch, Identity
from fleet_contract import (
    NEVER,
    JsonObject,
    Outgoing,
    bundle_messages,
    fluid_message,
    read_message,
    shift_message,
    status_message,
    takes_bundles,
)
from fleet_link import Message
from tests.golden import messages_v1
from tests.support.fleet import NOW, delivered, fleet_result, message_of
from tests.support.outboxes import STATUS
from tests.support.patience import HANG_S


class Records:
    """A broker and a store that write down what is asked of them, in order."""

    def __init__(self, batches: Sequence[Sequence[Message]] = (), *, takes_bundles: bool = True) -> None:
        self.takes_bundles = takes_bundles
        self.unsettled_count = 0
        self.steps: list[str] = []
        self.stored: list[Batch] = []
        self.sent: list[Outgoing] = []
        self.settled: list[Message] = []
        self.known_fills: dict[str, list[JsonObject]] = {}
        self.refuse: Callable[[Batch], None] = lambda _batch: None
        self._batches = list(batches)

    async def collect(self, limit: int, patience_s: float) -> list[Message]:
        self.steps.append(f"collect up to {limit} within {patience_s:g} s")
        await asyncio.sleep(0)
        if not self._batches:
            raise BrokerError("connection lost")
        return list(self._batches.pop(0))

    def send(self, messages: Sequence[Outgoing]) -> None:
        self.steps.append("send")
        self.sent.extend(messages)

    def settle(self, messages: Sequence[Message]) -> None:
        self.steps.append("settle")
        self.settled.extend(messages)

    def fills(self, vehicles: Sequence[str]) -> dict[str, list[JsonObject]]:
        self.steps.append("fills")
        return {vehicle: self.known_fills[vehicle] for vehicle in vehicles if vehicle in self.known_fills}

    def store(self, batch: Batch) -> frozenset[Identity]:
        self.steps.append("store")
        self.refuse(batch)
        self.stored.append(batch)
        return frozenset()

    @asynccontextmanager
    async def connect(self) -> AsyncIterator["Records"]:
        self.steps.append("connect")
        yield self


def worker_of(records: Records) -> Worker:
    return Worker(records.connect, records, name="w", now=lambda: NOW, pace=Pace())


@pytest.fixture(autouse=True)
def _short_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet_backend.ingest.FIRST_PAUSE_S", 0.001)
    monkeypatch.setattr("fleet_backend.ingest.LONGEST_PAUSE_S", 0.002)


def outcomes(records: Records) -> list[tuple[str, int, str]]:
    return [
        (message.topic.split("/")[2], entry["seq"], entry["outcome"])
        for message in records.sent
        for entry in json.loads(message.payload)["data"]["results"]
    ]


async def test_the_commit_comes_first_and_the_broker_hears_last() -> None:
    records = Records()
    messages = [message_of(fleet_result(seq, vehicle=f"car{seq}"), seq) for seq in (1, 2)]
    await worker_of(records).settle(records, messages)
    assert records.steps == ["store", "send", "send", "settle"]
    assert outcomes(records) == [("car1", 1, "accepted"), ("car2", 2, "accepted")]
    assert records.settled == messages


async def test_a_database_that_is_away_is_waited_for() -> None:
    records = Records()
    failures = iter([True, True, True, False])

    def refuse(_batch: Batch) -> None:
        if next(failures):
            raise DatabaseAwayError("gone")

    records.refuse = refuse
    await worker_of(records).settle(records, [message_of(fleet_result(1))])
    assert records.steps == ["store"] * 4 + ["send", "settle"]
    assert len(records.stored) == 1


async def test_one_row_that_never_fits_does_not_stop_the_others() -> None:
    records = Records()

    def refuse(batch: Batch) -> None:
        if any(row["seq"] == 3 for row in batch.shifts):
            raise RowRefusedError("seq 3 is cursed")

    records.refuse = refuse
    await worker_of(records).settle(records, [message_of(fleet_result(seq), seq) for seq in range(1, 9)])
    stored = sorted(int(str(row["seq"])) for batch in records.stored for row in batch.shifts)
    assert stored == [1, 2, 4, 5, 6, 7, 8]
    assert [row["reason"] for batch in records.stored for row in batch.quarantined] == ["database"]
    assert ("car1", 3, "quarantined") in outcomes(records)
    assert len(records.settled) == 8


async def test_of_bundles_no_more_than_a_batch_is_stored_at_a_time() -> None:
    records = Records()
    pace = Pace(batch_size=3)
    seqs = iter(range(1, 100))
    messages = [
        delivered(one, packet_id)
        for packet_id in (1, 2, 3)
        for one in bundle_messages([shift_message(shift_record(fleet_result(next(seqs)))) for _ in range(2)])
    ]
    await Worker(records.connect, records, name="w", now=lambda: NOW, pace=pace).settle(records, messages)
    assert records.steps == ["store", "send", "settle"] * 2
    assert [len(batch.shifts) for batch in records.stored] == [4, 2]
    assert outcomes(records) == [("car1", seq, "accepted") for seq in range(1, 7)]
    assert records.settled == messages


@pytest.mark.parametrize("reach_us", [False, True])
@pytest.mark.parametrize("are_wanted", [False, True])
async def test_vehicles_hear_whether_bundles_are_taken(*, reach_us: bool, are_wanted: bool) -> None:
    records = Records(takes_bundles=reach_us)
    pace = Pace(takes_bundles=are_wanted)
    worker = Worker(records.connect, records, name="w", now=lambda: NOW, pace=pace)
    await worker.settle(records, [message_of(fleet_result(1))])
    (ack,) = records.sent
    assert takes_bundles(read_message(ack.topic, ack.payload).data) is (reach_us and are_wanted)


async def test_poison_is_kept_settled_and_counted() -> None:
    records = Records()
    worker = worker_of(records)
    await worker.settle(records, [Message(topic="x", payload=b"", packet_id=1), message_of(fleet_result(1), 2)])
    assert worker.counts == {MessageKind.POISON: 1, MessageKind.SHIFT: 1}
    assert len(records.settled) == 2
    assert len(records.sent) == 1


async def test_it_comes_back_after_every_lost_connection() -> None:
    records = Records([[message_of(fleet_result(1))], []])
    task = asyncio.ensure_future(worker_of(records).run())
    async with asyncio.timeout(HANG_S):
        while records.steps.count("connect") < 4:  # noqa: ASYNC110 - the worker has no event for it
            await asyncio.sleep(0.001)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    assert len(records.stored) == 1


def test_results_are_shared_among_workers_and_states_go_to_each() -> None:
    assert FILTERS == (
        "$share/ingest/clutchdiag/v1/+/shift",
        "$share/ingest/clutchdiag/v1/+/bundle",
        "clutchdiag/v1/+/status",
        "clutchdiag/v1/+/metrics",
        "clutchdiag/v1/+/controller",
        "clutchdiag/v1/+/fluid",
    )


def test_the_broker_may_send_two_batches_at_most() -> None:
    assert Pace(batch_size=70).max_unsettled == 140


NOW_TEXT = "2026-03-01T12:00:00.000000Z"
FILL: JsonObject = {
    "filled_at": "2026-01-01T00:00:00.000000Z",
    "odometer_m": 61_200_000.0,
    "product": "DCTF-II",
    "note": None,
}


async def test_a_vehicle_that_comes_hears_which_fills_the_fleet_knows() -> None:
    records = Records()
    records.known_fills = {"car1": [FILL], "car2": [FILL]}
    await worker_of(records).settle(records, [delivered(messages_v1()["status-online"])])
    assert records.steps == ["store", "fills", "send", "settle"]
    (told,) = records.sent
    assert (told.topic, told.is_retained) == ("clutchdiag/v1/car1/fills", True)
    assert read_message(told.topic, told.payload).data["fills"] == [FILL]


async def test_a_vehicle_that_goes_hears_nothing_and_one_that_comes_that_there_is_no_fill() -> None:
    records = Records()
    await worker_of(records).settle(records, [delivered(messages_v1()["status-offline"])])
    assert records.steps == ["store", "settle"]
    await worker_of(records).settle(records, [delivered(messages_v1()["status-online"])])
    (told,) = records.sent
    assert (told.is_retained, read_message(told.topic, told.payload).data["fills"]) == (False, [])


async def test_an_analysis_hears_which_fills_the_fleet_knows() -> None:
    records = Records()
    records.known_fills = {"car1": [FILL]}
    status = replace(STATUS, is_online=False, connected_at=NEVER)
    await worker_of(records).settle(records, [delivered(status_message(status_record(status)))])
    (told,) = records.sent
    assert read_message(told.topic, told.payload).data["fills"] == [FILL]


async def test_a_vehicle_that_stays_hears_of_a_fill_once_when_the_fleet_has_noted_it() -> None:
    records, metrics = Records(), delivered(messages_v1()["metrics"])
    worker = worker_of(records)
    await worker.settle(records, [metrics])
    assert records.sent == []
    records.known_fills = {"car1": [FILL]}
    for _ in range(2):
        await worker.settle(records, [metrics])
    (told,) = records.sent
    assert read_message(told.topic, told.payload).data["fills"] == [FILL]


async def test_the_fills_that_a_vehicle_knows_are_stored() -> None:
    records = Records()
    worker = worker_of(records)
    unnamed = FILL | {"product": None}
    await worker.settle(records, [delivered(fluid_message("car1", NOW_TEXT, [FILL, unnamed], is_to_vehicle=False))])
    (batch,) = records.stored
    assert [row["product"] for row in batch.fills] == ["DCTF-II", "not named"]
    assert worker.counts == {MessageKind.FILLS: 1}
