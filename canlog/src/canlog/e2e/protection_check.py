"""Which frames may be believed: length, then CRC, then alive counter, as AUTOSAR E2E profile 1 orders them.

A message is followed from one origin: the channel and, with J1939, the source address that the profile names, else
those of its first sound frame. Frames of the same message from elsewhere are counted and never mixed in.
"""

from collections.abc import Mapping, Sequence
from enum import IntEnum
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from cantools.database.can import Message

from canlog.arrays import Int64Array, Records, UInt8Array, UInt32Array
from canlog.database.addressing import (
    ANY,
    NOBODY,
    AddressBook,
    MessageAddress,
    address_book,
    find_slot,
    message_address,
)
from canlog.e2e.alive_counter import IN_SEQUENCE, REPEATED, forget, fresh_links, judge, note_unusable
from canlog.e2e.late_frames import LateFrames
from canlog.e2e.message_contract import message_contract
from canlog.e2e.profile1 import COUNTER_BYTE, COUNTER_MASK, CRC_BYTE, CRC_TABLES, data_id_remainder
from canlog.errors import DefinitionError
from canlog.frames import ERROR_FLAG, FD_PAYLOAD_BYTES, PAYLOAD_BYTES, REMOTE_FLAG, FrameBatch, empty_batch
from canlog.jit import kernel, part

ORIGINS: Final = 256  # channels, and J1939 source addresses

_NONE: Final = -1
_NS_PER_MS: Final = 1_000_000
_NO_DATA_FRAME: Final = REMOTE_FLAG | ERROR_FLAG


class FrameReason(IntEnum):
    """Why a frame was not used; OK is 0."""

    OK = 0
    UNKNOWN_ID = 1  # not a message that is looked at: ignored, not rejected
    REMOTE_OR_ERROR = 2
    SHORT = 3
    BAD_CRC = 4
    REPEATED = 5  # the counter did not move
    WRONG_SEQUENCE = 6  # the counter moved further than time permits
    OTHER_CHANNEL = 7  # of a message that is followed on another channel
    OTHER_SENDER = 8  # of a J1939 message that is followed from another source address


_OK, _UNKNOWN_ID, _REMOTE_OR_ERROR, _SHORT, _BAD_CRC, _REPEATED, _WRONG_SEQUENCE, _OTHER_CHANNEL, _OTHER_SENDER = (
    int(reason) for reason in FrameReason
)


class Rules(NamedTuple):
    """What is demanded of each message, arrays of shape (m,)."""

    min_length: Int64Array
    is_protected: Int64Array
    id_remainder: UInt8Array
    cycle_ns: Int64Array


class Origins(NamedTuple):
    """Where each message is followed from, ANY until it is known, and how many frames came from where."""

    channel: Int64Array  # (m,) as frames are marked: a channel of a bus, or the source that stands for one of a log
    sender: Int64Array  # (m,) J1939 source address
    named: Int64Array  # (m,) the only channel that is listened to, ANY if all are
    number: Int64Array  # (256,) channel that a mark stands for
    channel_frames: Int64Array  # (m, 256) by number
    sender_frames: Int64Array  # (m, 256), of J1939 messages


class FrameColumns(NamedTuple):
    """What is looked at of each frame, arrays of shape (n,) and payloads of shape (n, width)."""

    t_ns: Int64Array
    can_id: UInt32Array
    length: UInt8Array
    data: UInt8Array
    channel: UInt8Array


class FrameVerdicts(NamedTuple):
    """What is said of each frame, arrays of shape (n,)."""

    reason: UInt8Array  # of FrameReason
    slot: Int64Array  # index of the message, -1 if the frame belongs to none
    sequence: Int64Array  # transmission number of accepted protected frames, else -1
    missing: Int64Array  # frames found missing at this one; negative takes back what was counted before

    @classmethod
    def room(cls, count: int) -> "FrameVerdicts":
        """Return arrays to be filled in for some frames."""
        return cls(np.empty(count, np.uint8), *(np.empty(count, np.int64) for _ in range(3)))


class FrameTotals(NamedTuple):
    frames: Int64Array  # (m + 1, reasons); the last row is of frames of no message
    missing: Int64Array  # (m,)
    marked: Int64Array  # (256, reasons), by the mark of the frames


@kernel
def judge_frames(
    book: AddressBook,
    rules: Rules,
    links: Records,
    origins: Origins,
    frames: FrameColumns,
    verdicts: FrameVerdicts,
    totals: FrameTotals,
) -> None:
    """Judge frames in their order: fill the verdicts, move the states on, add to the counts."""
    for row in range(frames.t_ns.size):
        verdicts.sequence[row] = _NONE
        verdicts.missing[row] = 0
        slot, reason = identify(book, origins, frames, row)
        if reason == _OK:
            reason = soundness(rules, frames, row, slot)
            if reason != _OK and rules.is_protected[slot]:
                note_unusable(links[slot])
        if reason == _OK:
            keep_origin(book, origins, frames, row, slot)
            if rules.is_protected[slot]:
                reason = sequence_reason(rules, links, frames, row, slot, verdicts)
                totals.missing[slot] += verdicts.missing[row]
        verdicts.slot[row] = slot
        verdicts.reason[row] = reason
        totals.frames[slot if slot != NOBODY else totals.missing.size, reason] += 1
        totals.marked[frames.channel[row], reason] += 1


@part
def identify(book: AddressBook, origins: Origins, frames: FrameColumns, row: int) -> tuple[int, int]:
    """Return the message of a frame and whether it comes from where that message is followed; count its origin."""
    can_id = frames.can_id[row]
    if can_id & _NO_DATA_FRAME:
        return NOBODY, _REMOTE_OR_ERROR
    slot = find_slot(book, int(can_id))
    if slot == NOBODY:
        return NOBODY, _UNKNOWN_ID
    channel = frames.channel[row]
    number = origins.number[channel]
    origins.channel_frames[slot, number] += 1
    if origins.channel[slot] != ANY and origins.channel[slot] != channel:
        return slot, _OTHER_CHANNEL
    if origins.named[slot] != ANY and origins.named[slot] != number:
        return slot, _OTHER_CHANNEL
    if book.is_group[slot]:
        sender = can_id & 0xFF
        origins.sender_frames[slot, sender] += 1
        if origins.sender[slot] != ANY and origins.sender[slot] != sender:
            return slot, _OTHER_SENDER
    return slot, _OK


@part
def soundness(rules: Rules, frames: FrameColumns, row: int, slot: int) -> int:
    if frames.length[row] < rules.min_length[slot]:
        return _SHORT
    if rules.is_protected[slot]:
        crc = rules.id_remainder[slot]
        for place in range(CRC_BYTE + 1, PAYLOAD_BYTES):
            crc ^= CRC_TABLES[place + 1, frames.data[row, place]]
        if crc != frames.data[row, CRC_BYTE]:
            return _BAD_CRC
    return _OK


@part
def keep_origin(book: AddressBook, origins: Origins, frames: FrameColumns, row: int, slot: int) -> None:
    """From its first sound frame on, a message is followed from where that came."""
    if origins.channel[slot] == ANY:
        origins.channel[slot] = frames.channel[row]
    if book.is_group[slot] and origins.sender[slot] == ANY:
        origins.sender[slot] = frames.can_id[row] & 0xFF


@part
def sequence_reason(
    rules: Rules, links: Records, frames: FrameColumns, row: int, slot: int, verdicts: FrameVerdicts
) -> int:
    """Return whether the counter of a sound frame is as it should be; number the frame, and tell what is missing."""
    counter = int(frames.data[row, COUNTER_BYTE] & COUNTER_MASK)
    outcome, missing = judge(links[slot], counter, frames.t_ns[row], rules.cycle_ns[slot])
    verdicts.missing[row] = missing
    if outcome == IN_SEQUENCE:
        verdicts.sequence[row] = links[slot].sequence
        return _OK
    return _REPEATED if outcome == REPEATED else _WRONG_SEQUENCE


class LinkMonitor:
    """Judges the frames of the messages that are looked at; verdicts do not depend on how the stream was cut.

    Messages whose database names no data id are checked for their length only. Frames are known by ``addresses``, or
    as the database says. Raises DefinitionError if two messages share an identifier, or a protected one does not have
    8 bytes.
    """

    def __init__(self, messages: Sequence[Message], addresses: Sequence[MessageAddress] | None = None) -> None:
        if addresses is None:
            addresses = [message_address(message) for message in messages]
        self._book = address_book(addresses)
        self._rules = _rules_of(messages)
        self._links = fresh_links(len(messages))
        self._origins = Origins(
            channel=np.full(len(messages), ANY, np.int64),
            named=np.array([address.channel for address in addresses], np.int64),
            number=np.arange(ORIGINS, dtype=np.int64),
            sender=np.array([address.sender for address in addresses], np.int64),
            channel_frames=np.zeros((len(messages), ORIGINS), np.int64),
            sender_frames=np.zeros((len(messages), ORIGINS), np.int64),
        )
        self._totals = FrameTotals(
            frames=np.zeros((len(messages) + 1, len(FrameReason)), np.int64),
            missing=np.zeros(len(messages), np.int64),
            marked=np.zeros((ORIGINS, len(FrameReason)), np.int64),
        )
        counted_ns = np.where(self._rules.is_protected, self._rules.cycle_ns, 0)
        self.late = LateFrames(self._book, counted_ns, self._links)
        self.check(empty_batch())  # compiles now: the first real batch must not wait for the compiler

    @property
    def counts(self) -> Int64Array:
        """Frames by message and reason, shape (m + 1, reasons); the last row counts frames of no message."""
        return self._totals.frames.copy()

    @property
    def missing(self) -> Int64Array:
        """Frames that the counter shows were sent but never came, by message, shape (m,)."""
        return self._totals.missing.copy()

    @property
    def held_back(self) -> Int64Array:
        """Accepted frames that came in short bursts, right behind a frame that was late, by message, shape (m,)."""
        return self._links["held_back"].copy()

    def senders(self, slot: int) -> Mapping[int, int]:
        """Return how many frames of a J1939 message each source address sent, on the channel that counts."""
        return _nonzero(self._origins.sender_frames[slot])

    def channels(self, slot: int) -> Mapping[int, int]:
        """Return how many frames of a message came on each channel."""
        return _nonzero(self._origins.channel_frames[slot])

    def begin_source(self, source: int, channel: int) -> None:
        """Learn that frames marked with ``source`` come from a channel of some log; at first a mark is the channel."""
        self._origins.number[source] = channel

    def source_counts(self, source: int) -> Mapping[FrameReason, int]:
        """Return what became of the frames with a mark since it was given; reasons that occurred."""
        return MappingProxyType({FrameReason(place): n for place, n in _nonzero(self._totals.marked[source]).items()})

    def end_source(self, source: int) -> None:
        """Follow its messages from where they are heard next: a log has ended, and its mark may be given to another."""
        self._origins.channel[self._origins.channel == source] = ANY
        self._totals.marked[source] = 0

    def reset(self) -> None:
        """Forget counters and times, after a jump of bus time; counts, sequence numbers and origins go on."""
        forget(self._links)

    def check(self, batch: FrameBatch) -> FrameVerdicts:
        verdicts = FrameVerdicts.room(len(batch))
        frames = FrameColumns(batch.t_ns, batch.can_id, batch.length, batch.data, batch.channel)
        judge_frames(self._book, self._rules, self._links, self._origins, frames, verdicts, self._totals)
        return verdicts


def _rules_of(messages: Sequence[Message]) -> Rules:
    contracts = [message_contract(message) for message in messages]
    for message, contract in zip(messages, contracts, strict=True):
        if contract.data_id is not None and message.length != PAYLOAD_BYTES:
            raise DefinitionError(
                f"{message.name}: protection is understood for messages of {PAYLOAD_BYTES} bytes only"
            )
    return Rules(
        min_length=np.array([min(message.length, FD_PAYLOAD_BYTES) for message in messages], np.int64),
        is_protected=np.array([contract.data_id is not None for contract in contracts], np.int64),
        id_remainder=np.array([data_id_remainder(contract.data_id or 0) for contract in contracts], np.uint8),
        cycle_ns=np.array([contract.cycle_ms * _NS_PER_MS for contract in contracts], np.int64),
    )


def _nonzero(counts: Int64Array) -> Mapping[int, int]:
    """Return the counts that are not zero, by their place."""
    return MappingProxyType({int(place): int(counts[place]) for place in np.flatnonzero(counts)})
