"""A vehicle that floods: what is beyond its quota waits in the vehicle, others lose nothing, and operators are told."""

import json
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from datetime import timedelta

import pytest
from sqlalchemy import Engine

from fleet_backend import queries
from fleet_backend.alarms.rules import AlarmRule
from fleet_backend.choices import Pace, Quotas
from fleet_backend.errors import BrokerError
from fleet_backend.ingest import Worker
from fleet_backend.intake import MessageKind
from fleet_backend.office.watching import Orders, Watch
from fleet_backend.quotas import QuotaGate
from fleet_backend.writer import Writer
from fleet_contract import Outgoing
from fleet_link import Message
from tests.support.fleet import NOW, fleet_result, message_of

QUOTAS = Quotas(results=5, quarantined=2, size_bytes=100_000)


class Office:
    """A worker with a gate of its own into a database, on a day that can be moved; its broker, too."""

    takes_bundles = True
    unsettled_count = 0

    def __init__(self, engine: Engine, quotas: Quotas = QUOTAS) -> None:
        self.at, self.gate = NOW, QuotaGate(engine, quotas)
        self.sent: list[Outgoing] = []
        self.settled: list[Message] = []
        self.worker = Worker(
            self.connect, Writer(engine), name="w", now=lambda: self.at, pace=Pace(), judge=self.gate.judge
        )

    @asynccontextmanager
    async def connect(self) -> AsyncIterator["Office"]:
        yield self

    async def collect(self, limit: int, patience_s: float) -> list[Message]:
        raise BrokerError(f"nothing of {limit} within {patience_s:g} s")

    def send(self, messages: Sequence[Outgoing]) -> None:
        self.sent += messages

    def acknowledge(self, messages: Sequence[Message]) -> None:
        self.settled += messages

    async def take(self, *messages: Message) -> set[tuple[str, int]]:
        """Take messages, add up with the other workers, and return which results got receipts: vehicle and seq."""
        self.sent.clear()
        await self.worker.process(self, messages)
        await self.gate.add_up()
        acks = [json.loads(one.payload)["data"] for one in self.sent if one.topic.endswith("/ack")]
        return {(ack["vehicle"], entry["seq"]) for ack in acks for entry in ack["results"]}


def results(vehicle: str, *seqs: int) -> list[Message]:
    return [message_of(fleet_result(seq, vehicle=vehicle)) for seq in seqs]


async def test_what_is_beyond_a_quota_waits_in_its_vehicle_and_comes_the_next_day(
    engine: Engine, caplog: pytest.LogCaptureFixture
) -> None:
    first, second = Office(engine), Office(engine)
    flood, good = results("flood", *range(1, 9)), results("good", *range(1, 6))
    heard = await first.take(*flood[:4], *good[:3])
    heard |= await second.take(*flood[4:6], *good[3:])  # it hears only now what the first took
    heard |= await second.take(*flood[6:])
    assert {seq for vehicle, seq in heard if vehicle == "good"} == {1, 2, 3, 4, 5}
    assert {seq for vehicle, seq in heard if vehicle == "flood"} == {1, 2, 3, 4, 5, 6}
    assert queries.result_count(engine) == 11
    assert len(first.settled) + len(second.settled) == 13  # the broker keeps nothing of it
    assert (first.worker.counts[MessageKind.WITHHELD], second.worker.counts[MessageKind.WITHHELD]) == (0, 2)
    assert [one.getMessage().split(" is beyond")[0] for one in caplog.records if "quota" in one.getMessage()] == [
        "flood"
    ]
    first.at = NOW + timedelta(days=1)
    assert await first.take(*flood[6:]) == {("flood", 7), ("flood", 8)}
    assert queries.result_count(engine) == 13


async def test_the_watch_raises_an_alarm_as_long_as_messages_are_withheld(engine: Engine) -> None:
    office, at = Office(engine), [NOW]
    await office.take(*results("flood", *range(1, 9)), *results("good", 1))
    watch = Watch(engine, Orders(), lambda: at[0])
    raised = [step for step in watch.round() if step.subject.rule is AlarmRule.QUOTA]
    assert [(step.subject.vehicle, step.event.value) for step in raised] == [("flood", "raised")]
    assert raised[0].reason.startswith("3 messages of today are beyond its quota")
    assert [step for step in watch.round() if step.subject.rule is AlarmRule.QUOTA] == []
    at[0] = NOW + timedelta(days=1)
    cleared = [step for step in watch.round() if step.subject.rule is AlarmRule.QUOTA]
    assert [step.event.value for step in cleared] == ["cleared"]
