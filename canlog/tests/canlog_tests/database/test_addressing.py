"""Frames are known by identifier or by J1939 parameter group, and followed from one channel and one sender."""

from pathlib import Path
from typing import Final

import cantools
import numpy as np
import pytest
from cantools.database.can import Database, Message

from canlog.database.addressing import (
    MessageAddress,
    address_book,
    find_slots,
    kernel_filters,
    message_address,
    overwritten,
    parameter_group,
)
from canlog.e2e.protection_check import FrameReason, LinkMonitor
from canlog.errors import DefinitionError
from canlog.frames import EXTENDED_FLAG, FrameBatch
from tests.support.batches import frames_at

CORNERS: Final = Path(__file__).parents[4] / "tests" / "data" / "corners.dbc"
EEC1: Final = 0x0CF0_0400  # group 61444, without its sender
OK: Final = FrameReason.OK
OTHER_CHANNEL: Final = FrameReason.OTHER_CHANNEL
OTHER_SENDER: Final = FrameReason.OTHER_SENDER


def eec1() -> Message:
    database = cantools.database.load_file(CORNERS)
    assert isinstance(database, Database)
    return database.get_message_by_name("EEC1")


def group(can_id: int, *, sender: int = -1, name: str = "G") -> MessageAddress:
    return MessageAddress(name=name, can_id=can_id, is_extended=True, is_group=True, sender=sender)


def slots(addresses: list[MessageAddress], *can_ids: int) -> list[int]:
    book = address_book(addresses)
    return list(find_slots(book, np.array(can_ids, np.uint32) | np.uint32(EXTENDED_FLAG)))


def batch(can_ids: list[int], channels: list[int] | None = None, length: int = 8) -> FrameBatch:
    return frames_at(np.arange(len(can_ids)) * 10_000_000, can_ids, length, channel=channels or 0)


def reasons(monitor: LinkMonitor, frames: FrameBatch) -> list[FrameReason]:
    return [FrameReason(reason) for reason in monitor.check(frames).reason.tolist()]


@pytest.mark.parametrize(
    ("can_id", "number"),
    [
        (0x0CF0_0400, 61444),  # EEC1, PDU 2: the specific byte is part of the group
        (0x18FE_F1FE, 65265),  # CCVS
        (0x18EA_FF0B, 0xEA00),  # request to all, PDU 1: the specific byte is the destination
        (0x1DEF_2103, 0x1EF00),  # data page 1
        (0x1FFF_FFFF, 0x3FFFF),
    ],
)
def test_parameter_group(can_id: int, number: int) -> None:
    assert parameter_group(can_id) == number


def test_messages_of_one_group_are_told_apart_by_sender() -> None:
    engine, retarder, rest = group(EEC1), group(EEC1 | 0x0F), group(EEC1 | 0xFE)
    assert slots([engine, retarder, rest], EEC1, EEC1 | 0x0F, EEC1 | 0x21) == [0, 1, 2]
    assert slots([engine, retarder], EEC1, EEC1 | 0x0F, EEC1 | 0x21) == [0, 1, -1]


@pytest.mark.parametrize(
    "addresses",
    [
        [group(0x0CF0_0400), group(0x18F0_0400)],
        [group(0x0CF0_0400, sender=3), group(0x0CF0_0401, sender=3)],
        [MessageAddress(name="A", can_id=5, is_extended=False, is_group=False)] * 2,
        [MessageAddress(name="A", can_id=5, is_extended=True, is_group=False)] * 2,
    ],
)
def test_messages_that_cannot_be_told_apart_are_refused(addresses: list[MessageAddress]) -> None:
    with pytest.raises(DefinitionError, match="several messages have the identifier"):
        address_book(addresses)
    assert overwritten(addresses) == {0: 1}


def test_the_first_sender_is_followed_and_the_others_are_counted() -> None:
    monitor = LinkMonitor([eec1()])
    ids = [can_id | EXTENDED_FLAG for can_id in (EEC1 | 7, EEC1 | 3, EEC1 | 7, 0x18F0_0407, EEC1 | 9)]
    assert reasons(monitor, batch(ids)) == [OK, OTHER_SENDER, OK, OK, OTHER_SENDER]
    monitor.reset()
    assert reasons(monitor, batch(ids[1:3])) == [OTHER_SENDER, OK]
    assert monitor.senders(0) == {3: 2, 7: 4, 9: 1}


def test_one_identifier_on_two_channels_is_counted_and_not_mixed() -> None:
    message = Message(0x100, "M", 8, [])
    monitor = LinkMonitor([message])
    assert reasons(monitor, batch([0x100] * 4, [2, 1, 2, 1])) == [OK, OTHER_CHANNEL, OK, OTHER_CHANNEL]
    assert monitor.channels(0) == {1: 2, 2: 2}
    assert not monitor.senders(0)
    named = LinkMonitor([message], [message_address(message, channel=1)])
    assert reasons(named, batch([0x100] * 4, [2, 1, 2, 1])) == [OTHER_CHANNEL, OK, OTHER_CHANNEL, OK]


@pytest.mark.parametrize(
    ("can_id", "is_extended", "is_group", "passes", "fails"),
    [
        (0x123, False, False, [0x123], [0x122, 0x8000_0123, 0x4000_0123]),
        (0x123, True, False, [0x8000_0123], [0x123, 0x8000_1123, 0xC000_0123]),
        (0x0CF00400, True, True, [0x8CF0_0400, 0x98F0_0455], [0x8CF0_0500, 0x0CF0_0400, 0x8CEF_0400]),
        (0x0CEF1122, True, True, [0x8CEF_1122, 0x98EF_FF00], [0x8CEE_1122, 0x8DEF_1122]),
    ],
)
def test_a_kernel_filter_lets_a_message_through_and_nothing_else(
    can_id: int, is_extended: bool, is_group: bool, passes: list[int], fails: list[int]
) -> None:
    address = MessageAddress(name="message", can_id=can_id, is_extended=is_extended, is_group=is_group)
    ((wanted, mask),) = kernel_filters([address])
    assert [one & mask == wanted & mask for one in passes] == [True] * len(passes)
    assert [one & mask == wanted & mask for one in fails] == [False] * len(fails)
