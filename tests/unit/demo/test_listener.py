"""What the subscriber makes of the messages of a broker that delivers at least once."""

import asyncio
from collections.abc import AsyncIterator

import aiomqtt
import pytest

from demo.errors import DemoError
from demo.listener import Listener
from diag_service.diagnosis.records import ServiceStatus, ShiftResult, shift_record, status_record
from fleet_contract import Channel, Outgoing, shift_message, status_message, topic_of
from tests.support.builders import shift_result

VEHICLE = "car1"


def message(out: Outgoing, *, is_retained: bool = False) -> aiomqtt.Message:
    return aiomqtt.Message(out.topic, out.payload, 1, is_retained, 1, None)


def foreign(channel: Channel, text: str) -> aiomqtt.Message:
    return message(Outgoing(topic=topic_of(VEHICLE, channel), payload=text.encode(), is_retained=False))


def shift(seq: int) -> aiomqtt.Message:
    return message(shift_message(shift_record(shift_result(seq))))


def status(*, is_online: bool, is_retained: bool = False) -> aiomqtt.Message:
    record = status_record(
        ServiceStatus(
            vehicle=VEHICLE,
            is_online=is_online,
            connected_at="2026-01-01T00:00:00.000000Z",
            service_version="1",
            algorithm_version="1",
            calibration_version="1",
        )
    )
    return message(status_message(record), is_retained=is_retained)


async def heard(*messages: aiomqtt.Message) -> tuple[Listener, list[ShiftResult]]:
    """Return a listener to whom these messages have been delivered, and what it passed on."""

    async def deliver() -> AsyncIterator[aiomqtt.Message]:
        for one in messages:
            yield one

    shown: list[ShiftResult] = []
    listener = Listener(deliver(), VEHICLE, shown.append)
    await listener.listen()
    return listener, shown


async def test_shifts_are_shown_as_they_come_and_kept_in_order() -> None:
    listener, shown = await heard(shift(2), shift(1))
    assert [result.seq for result in shown] == [2, 1]
    assert [result.seq for result in listener.shifts] == [1, 2]
    await asyncio.wait_for(listener.shift_count(2), 1.0)


async def test_a_repeated_delivery_counts_once() -> None:
    listener, shown = await heard(shift(1), shift(1))
    assert (len(listener.shifts), len(shown)) == (1, 1)


async def test_the_service_is_online_when_it_says_so_now() -> None:
    listener, _ = await heard(status(is_online=True))
    await asyncio.wait_for(listener.service_online(), 1.0)


@pytest.mark.parametrize(
    "messages",
    [(status(is_online=True, is_retained=True),), (status(is_online=True), status(is_online=False))],
    ids=["an earlier one, as the broker kept it", "gone again"],
)
async def test_the_service_is_not_online(messages: tuple[aiomqtt.Message, ...]) -> None:
    listener, _ = await heard(*messages)
    with pytest.raises(TimeoutError):
        await asyncio.wait_for(listener.service_online(), 0.01)


@pytest.mark.parametrize(
    ("channel", "text"), [(Channel.SHIFT, "{}"), (Channel.STATUS, "hello"), (Channel.STATUS, "{}")]
)
async def test_a_foreign_message_is_an_error(channel: Channel, text: str) -> None:
    with pytest.raises(DemoError, match="not of this service"):
        await heard(foreign(channel, text))
