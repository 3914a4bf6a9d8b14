"""The compiled loop that judges frames one by one: which message, from where, whole, unharmed, in sequence."""

from enum import IntEnum
from typing import Final, NamedTuple

from canlog.arrays import Int64Array, UInt8Array, UInt32Array
from canlog.database.addressing import ANY, NOBODY, AddressBook, find_slot
from canlog.e2e.alive_counter import IN_SEQUENCE, REPEATED, LinkState, judge, note_unusable
from canlog.e2e.profile1 import COUNTER_BYTE, COUNTER_MASK, CRC_BYTE, CRC_TABLES
from canlog.frames import ERROR_FLAG, PAYLOAD_BYTES, REMOTE_FLAG
from canlog.jit import array_kernel

ORIGINS: Final = 256  # channels, and J1939 source addresses

_NONE: Final = -1
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


_OK: Final = int(FrameReason.OK)
_UNKNOWN_ID: Final = int(FrameReason.UNKNOWN_ID)
_REMOTE_OR_ERROR: Final = int(FrameReason.REMOTE_OR_ERROR)
_SHORT: Final = int(FrameReason.SHORT)
_BAD_CRC: Final = int(FrameReason.BAD_CRC)
_REPEATED: Final = int(FrameReason.REPEATED)
_WRONG_SEQUENCE: Final = int(FrameReason.WRONG_SEQUENCE)
_OTHER_CHANNEL: Final = int(FrameReason.OTHER_CHANNEL)
_OTHER_SENDER: Final = int(FrameReason.OTHER_SENDER)


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


class Totals(NamedTuple):
    """Running counts."""

    frames: Int64Array  # (m + 1, reasons); the last row is of frames of no message
    missing: Int64Array  # (m,)
    marked: Int64Array  # (256, reasons), by the mark of the frames


@array_kernel
def judge_frames(
    book: AddressBook,
    rules: Rules,
    links: LinkState,
    origins: Origins,
    frames: FrameColumns,
    verdicts: FrameVerdicts,
    totals: Totals,
) -> None:
    """Judge frames in their order: fill the verdicts, move the states on, add to the counts."""
    for row in range(frames.t_ns.size):
        verdicts.sequence[row] = _NONE
        verdicts.missing[row] = 0
        slot, reason = identify(book, origins, frames, row)
        if reason == _OK:
            reason = soundness(rules, frames, row, slot)
            if reason != _OK and rules.is_protected[slot]:
                note_unusable(links, slot)
        if reason == _OK:
            follow(book, origins, frames, row, slot)
            if rules.is_protected[slot]:
                reason = sequence_reason(rules, links, frames, row, slot, verdicts)
                totals.missing[slot] += verdicts.missing[row]
        verdicts.slot[row] = slot
        verdicts.reason[row] = reason
        totals.frames[slot if slot != NOBODY else totals.missing.size, reason] += 1
        totals.marked[frames.channel[row], reason] += 1


@array_kernel
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


@array_kernel
def soundness(rules: Rules, frames: FrameColumns, row: int, slot: int) -> int:
    """Return whether a frame is whole and unharmed."""
    if frames.length[row] < rules.min_length[slot]:
        return _SHORT
    if rules.is_protected[slot]:
        crc = rules.id_remainder[slot]
        for place in range(CRC_BYTE + 1, PAYLOAD_BYTES):
            crc ^= CRC_TABLES[place + 1, frames.data[row, place]]
        if crc != frames.data[row, CRC_BYTE]:
            return _BAD_CRC
    return _OK


@array_kernel
def follow(book: AddressBook, origins: Origins, frames: FrameColumns, row: int, slot: int) -> None:
    """From its first sound frame on, a message is followed from where that came."""
    if origins.channel[slot] == ANY:
        origins.channel[slot] = frames.channel[row]
    if book.is_group[slot] and origins.sender[slot] == ANY:
        origins.sender[slot] = frames.can_id[row] & 0xFF


@array_kernel
def sequence_reason(
    rules: Rules, links: LinkState, frames: FrameColumns, row: int, slot: int, verdicts: FrameVerdicts
) -> int:
    """Return whether the counter of a sound frame is as it should be; number the frame, and tell what is missing."""
    counter = int(frames.data[row, COUNTER_BYTE] & COUNTER_MASK)
    outcome, missing = judge(links, slot, counter, frames.t_ns[row], rules.cycle_ns[slot])
    verdicts.missing[row] = missing
    if outcome == IN_SEQUENCE:
        verdicts.sequence[row] = links.sequence[slot]
        return _OK
    return _REPEATED if outcome == REPEATED else _WRONG_SEQUENCE
