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
    find_slots,
    message_address,
)
from canlog.e2e.alive_counter import IN_SEQUENCE, forget, fresh_links, judge, note_unusable
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
    OUT_OF_ORDER = 9  # it lies before the last accepted frame of its message


(
    _OK,
    _UNKNOWN_ID,
    _REMOTE_OR_ERROR,
    _SHORT,
    _BAD_CRC,
    _REPEATED,
    _WRONG_SEQUENCE,
    _OTHER_CHANNEL,
    _OTHER_SENDER,
    _OUT_OF_ORDER,
) = (int(reason) for reason in FrameReason)
_SEQUENCE_REASONS: Final = (_OK, _REPEATED, _WRONG_SEQUENCE)  # by the verdict on the counter


class Rule:
    """What is demanded of a message, and where it is followed from, ANY until that is known: a record of an array."""

    min_length: int
    is_protected: int
    id_remainder: int
    cycle_ns: int
    is_group: int  # known by its J1939 parameter group
    named: int  # the only channel that is listened to, ANY if all are
    channel: int  # as frames are marked: a channel of a bus, or the source that stands for one of a log
    sender: int  # J1939 source address


_RULE_TYPE: Final = np.dtype([(name, np.int64) for name in Rule.__annotations__])


class Origins(NamedTuple):
    """How many frames came from where."""

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
    """The verdict on each frame, arrays of shape (n,)."""

    reason: UInt8Array  # of FrameReason
    slot: Int64Array  # index of the message, NOBODY if the frame belongs to none
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
    rules: Records, links: Records, origins: Origins, frames: FrameColumns, verdicts: FrameVerdicts, totals: FrameTotals
) -> None:
    """Judge frames in their order: fill the verdicts but for the slot, move the states on, add to the counts."""
    for row in range(frames.t_ns.size):
        slot, can_id, channel = verdicts.slot[row], frames.can_id[row], frames.channel[row]
        sequence, missing = _NONE, 0
        if slot == NOBODY:
            reason = _REMOTE_OR_ERROR if can_id & _NO_DATA_FRAME else _UNKNOWN_ID
        else:
            rule, number, sender = rules[slot], origins.number[channel], can_id & 0xFF
            reason = origin_reason(rule, channel, number, sender)
            origins.channel_frames[slot, number] += 1
            origins.sender_frames[slot, sender] += 1 if rule.is_group and reason != _OTHER_CHANNEL else 0
            if reason == _OK:
                reason = soundness(rule, frames.length[row], frames.data, row)
                if reason != _OK:
                    note_unusable(links[slot])
                elif frames.t_ns[row] < links[slot].heard_ns:
                    reason = _OUT_OF_ORDER
                else:
                    keep_origin(rule, channel, sender)
            if reason == _OK and rule.is_protected:
                counter = frames.data[row, COUNTER_BYTE] & COUNTER_MASK
                outcome, missing = judge(links[slot], counter, frames.t_ns[row], rule.cycle_ns)
                reason = _SEQUENCE_REASONS[outcome]
                sequence = links[slot].sequence if outcome == IN_SEQUENCE else _NONE
                totals.missing[slot] += missing
            if reason == _OK:
                links[slot].heard_ns = frames.t_ns[row]
        verdicts.reason[row], verdicts.sequence[row], verdicts.missing[row] = reason, sequence, missing
        totals.frames[slot if slot != NOBODY else totals.missing.size, reason] += 1
        totals.marked[channel, reason] += 1


@part
def origin_reason(rule: Rule, channel: int, number: int, sender: int) -> int:
    """Return whether a frame comes from where its message is followed."""
    if ANY != rule.channel != channel or ANY != rule.named != number:
        return _OTHER_CHANNEL
    if rule.is_group and ANY != rule.sender != sender:
        return _OTHER_SENDER
    return _OK


@part
def soundness(rule: Rule, length: int, data: UInt8Array, row: int) -> int:
    if length < rule.min_length:
        return _SHORT
    if rule.is_protected:
        crc = rule.id_remainder
        for place in range(CRC_BYTE + 1, PAYLOAD_BYTES):
            crc ^= CRC_TABLES[place + 1, data[row, place]]
        if crc != data[row, CRC_BYTE]:
            return _BAD_CRC
    return _OK


@part
def keep_origin(rule: Rule, channel: int, sender: int) -> None:
    """From its first sound frame on, a message is followed from where that came."""
    if rule.channel == ANY:
        rule.channel = channel
    if rule.is_group and rule.sender == ANY:
        rule.sender = sender


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
        self._rules = _rules_of(messages, addresses)
        self._links = fresh_links(len(messages))
        self._origins = Origins(
            number=np.arange(ORIGINS, dtype=np.int64),
            channel_frames=np.zeros((len(messages), ORIGINS), np.int64),
            sender_frames=np.zeros((len(messages), ORIGINS), np.int64),
        )
        self._totals = FrameTotals(
            frames=np.zeros((len(messages) + 1, len(FrameReason)), np.int64),
            missing=np.zeros(len(messages), np.int64),
            marked=np.zeros((ORIGINS, len(FrameReason)), np.int64),
        )
        counted_ns = np.where(self._rules["is_protected"], self._rules["cycle_ns"], 0)
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
        self._rules["channel"][self._rules["channel"] == source] = ANY
        self._totals.marked[source] = 0

    def reset(self) -> None:
        """Forget counters and times, after a jump of bus time; counts, sequence numbers and origins go on."""
        forget(self._links)

    def check(self, batch: FrameBatch) -> FrameVerdicts:
        verdicts = FrameVerdicts.room(len(batch))._replace(slot=find_slots(self._book, batch.can_id))
        frames = FrameColumns(batch.t_ns, batch.can_id, batch.length, batch.data, batch.channel)
        judge_frames(self._rules, self._links, self._origins, frames, verdicts, self._totals)
        return verdicts

    @property
    def book(self) -> AddressBook:
        """By which its messages are known."""
        return self._book


def _rules_of(messages: Sequence[Message], addresses: Sequence[MessageAddress]) -> Records:
    rules = np.empty(len(messages), _RULE_TYPE)
    for slot, (message, address) in enumerate(zip(messages, addresses, strict=True)):
        contract = message_contract(message)
        if contract.data_id is not None and message.length != PAYLOAD_BYTES:
            raise DefinitionError(
                f"{message.name}: protection is understood for messages of {PAYLOAD_BYTES} bytes only"
            )
        rules[slot] = (
            min(message.length, FD_PAYLOAD_BYTES),
            contract.data_id is not None,
            data_id_remainder(contract.data_id or 0),
            contract.cycle_ms * _NS_PER_MS,
            address.is_group,
            address.channel,
            ANY,
            address.sender,
        )
    return rules


def _nonzero(counts: Int64Array) -> Mapping[int, int]:
    """Return the counts that are not zero, by their place."""
    return MappingProxyType({int(place): int(counts[place]) for place in np.flatnonzero(counts)})
