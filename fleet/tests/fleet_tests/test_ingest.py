"""What comes is judged, committed and only then acknowledged."""

import asyncio
import json
import zlib
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from hashlib import blake2b

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clutch_results.records import iso_utc, shift_record
from fleet_backend.choices import Pace
from fleet_backend.errors import BrokerError, RowRefusedError
from fleet_backend.ingest import Worker
from fleet_backend.intake import MessageKind, receive, receive_all
from fleet_backend.rows import CONTENT, content_digest, moment, quarantine_row, shift_row
from fleet_backend.schema import CLOCK_ERROR, FRICTION_COLUMNS
from fleet_backend.writer import Batch, Identity
from fleet_contract import (
    JsonObject,
    Outgoing,
    bundle_messages,
    fluid_message,
    read_message,
    shift_message,
    takes_bundles,
)
from fleet_link import Message
from tests.golden import FOLDER as GOLDEN
from tests.golden import messages_v1
from tests.support.fleet import NOW, delivered, fleet_result, message_of, row_of


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

    def acknowledge(self, messages: Sequence[Message]) -> None:
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
    await worker_of(records).process(records, messages)
    assert records.steps == ["store", "send", "send", "settle"]
    assert outcomes(records) == [("car1", 1, "accepted"), ("car2", 2, "accepted")]
    assert records.settled == messages


async def test_one_row_that_never_fits_does_not_stop_the_others() -> None:
    records = Records()

    def refuse(batch: Batch) -> None:
        if any(row["seq"] == 3 for row in batch.shifts):
            raise RowRefusedError("seq 3 is cursed")

    records.refuse = refuse
    await worker_of(records).process(records, [message_of(fleet_result(seq), seq) for seq in range(1, 9)])
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
    await Worker(records.connect, records, name="w", now=lambda: NOW, pace=pace).process(records, messages)
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
    await worker.process(records, [message_of(fleet_result(1))])
    (ack,) = records.sent
    assert takes_bundles(read_message(ack.topic, ack.payload).data) is (reach_us and are_wanted)


async def test_a_vehicle_that_goes_hears_nothing_and_one_that_comes_that_there_is_no_fill() -> None:
    records = Records()
    await worker_of(records).process(records, [delivered(messages_v1()["status-offline"])])
    assert records.steps == ["store", "settle"]
    await worker_of(records).process(records, [delivered(messages_v1()["status-online"])])
    (told,) = records.sent
    assert (told.is_retained, read_message(told.topic, told.payload).data["fills"]) == (False, [])


GOOD = message_of(fleet_result(7))
CHANGED_AT = NOW - timedelta(days=3)
FILL = {"filled_at": "", "odometer_m": None, "product": "DCTF 75W", "note": None}


def fluid_of(*moments: datetime, withdrawn: Sequence[datetime] = ()) -> Message:
    """Return the message of a vehicle that knows fills of some moments, and such as are taken back."""
    fills: list[JsonObject] = [{**FILL, "filled_at": iso_utc(at)} for at in moments]
    fills += [{"filled_at": iso_utc(at), "is_withdrawn": True} for at in withdrawn]
    return delivered(fluid_message("car1", iso_utc(NOW), fills, is_to_vehicle=False))


def test_a_fill_that_is_yet_to_come_is_put_aside_with_what_to_do() -> None:
    received = receive(fluid_of(CHANGED_AT, datetime(2199, 1, 1, tzinfo=UTC)), NOW)
    assert received.kind is MessageKind.POISON
    assert (received.row["vehicle"], received.row["reason"]) == ("car1", "clock")
    assert received.row["detail"] == (
        "a fluid fill at 2199-01-01 00:00 UTC is yet to come: set the clock of the vehicle, and take the fill back "
        "there (diag-service fluid-changed --undo)"
    )
    assert not received.fills


def test_a_fill_within_a_day_and_a_future_one_that_is_taken_back_are_taken() -> None:
    fills = receive(fluid_of(CHANGED_AT, NOW + CLOCK_ERROR), NOW).fills
    assert [row["filled_at"] for row in fills] == [CHANGED_AT, NOW + CLOCK_ERROR]
    withdrawn = receive(fluid_of(CHANGED_AT, withdrawn=[datetime(2199, 1, 1, tzinfo=UTC)]), NOW)
    assert withdrawn.kind is MessageKind.FILLS
    assert len(withdrawn.fills) == 2


def changed(message: Message, **data: object) -> Message:
    """Return a message whose data say something else."""
    event = json.loads(message.payload)
    event["data"] |= data
    return replace(message, payload=json.dumps(event).encode())


def bundle(*payloads: bytes) -> Message:
    return Message(
        topic="clutchdiag/v1/car1/bundle", payload=zlib.compress(b"[" + b",".join(payloads) + b"]"), packet_id=1
    )


def test_each_result_of_a_bundle_is_judged_as_if_it_had_come_alone() -> None:
    stranger = changed(GOOD, vehicle="car2")
    alone = [GOOD, changed(GOOD, quality=2.0), stranger, replace(GOOD, payload=b"7"), message_of(fleet_result(8))]
    received = receive_all(bundle(*(message.payload for message in alone)), NOW)
    assert received == [receive(replace(message, packet_id=1), NOW) for message in alone]
    reasons = [item.row["reason"] if item.kind is MessageKind.POISON else None for item in received]
    assert reasons == [None, "schema", "identity", "malformed", None]
    assert receive_all(GOOD, NOW) == [receive(GOOD, NOW)]


def test_what_cannot_be_unpacked_is_one_message_kept_aside() -> None:
    for message in (replace(bundle(), payload=b"x"), bundle(), bundle(*[b"1"] * 51)):
        (received,) = receive_all(message, NOW)
        assert (received.kind, received.row["reason"], received.receipt) == (MessageKind.POISON, "malformed", None)
        assert (received.row["vehicle"], received.message) == ("car1", message)
    (received,) = receive_all(replace(bundle(GOOD.payload), topic="clutchdiag/v1/car 1/bundle"), NOW)
    assert received.row["reason"] == "topic"


def test_what_is_too_long_is_kept_aside_unread_and_its_size_is_that_of_all_its_parts() -> None:
    """Of what can still be told from others the sender hears, so that it does not come again."""
    hostile = replace(GOOD, unread_bytes=250_000, excess="250000 bytes of properties, more than 1024")
    (received,) = receive_all(hostile, NOW)
    size_bytes = len(GOOD.topic) + 250_000 + len(GOOD.payload)
    assert (received.kind, received.row["reason"], received.row["size_bytes"]) == (
        *(MessageKind.POISON, "malformed"),
        size_bytes,
    )
    assert received.row["detail"] == hostile.excess
    assert received.receipt is not None
    (received,) = receive_all(replace(hostile, topic="clutchdiag/v1/car1/bundle"), NOW)
    assert (received.kind, received.receipt) == (MessageKind.POISON, None)


def test_properties_of_a_bundle_count_once() -> None:
    sizes = [item.message.size_bytes for item in receive_all(bundle(GOOD.payload, GOOD.payload), NOW)]
    packed = replace(bundle(GOOD.payload, GOOD.payload), unread_bytes=1_000)
    assert [item.message.size_bytes for item in receive_all(packed, NOW)] == [sizes[0] + 1_000, sizes[1]]


@pytest.mark.parametrize(
    ("name", "said", "kept"),
    [
        ("status-online", "connected_at", "connected_at"),
        ("metrics", "produced_at", "metrics_at"),
        ("controller", "produced_at", "controller_at"),
    ],
)
def test_a_state_of_a_clock_that_is_far_ahead_is_of_when_it_came(name: str, said: str, kept: str) -> None:
    message, near = delivered(messages_v1()[name]), "2026-03-02T11:00:00.000000Z"
    found = [receive(changed(message, **{said: at}), NOW).row[kept] for at in (near, near.replace("2026", "2038"))]
    assert found == [moment(near), NOW]


ROW = row_of(fleet_result())


@given(st.binary(max_size=200), st.text(max_size=50))
def test_whatever_came_is_kept_in_printable_text(payload: bytes, detail: str) -> None:
    row = quarantine_row(NOW, topic=f"x/{detail}", vehicle=None, payload=payload, reason="malformed", detail=detail)
    for name in ("topic", "detail", "head"):
        text = str(row[name])
        assert text.isprintable()
        assert text.encode().decode() == text
    assert row["size_bytes"] == len(f"x/{detail}".encode()) + len(payload)


@pytest.mark.parametrize(("name", "known"), [("shift", -3664896956469182395), ("shift-rejected", -5958550621060343079)])
def test_the_digest_of_a_content_is_for_ever(name: str, known: int) -> None:
    data = json.loads((GOLDEN / "v1" / f"{name}.json").read_text(encoding="utf-8"))["data"]
    assert shift_row(data)["content_digest"] == known


@settings(max_examples=40)
@given(st.lists(st.floats() | st.floats(1e-5, 1e-3) | st.sampled_from([0.0, -0.0, 1e-4, 1e16]), min_size=8, max_size=8))
def test_a_digest_is_made_of_what_python_writes_for_numbers(numbers: list[float]) -> None:
    row = ROW | dict(zip(FRICTION_COLUMNS, numbers, strict=False))
    told = repr(tuple(row[name] for name in CONTENT)).encode()
    assert content_digest(row) == int.from_bytes(blake2b(told, digest_size=8).digest(), signed=True)
