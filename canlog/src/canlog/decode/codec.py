"""All signals of a database: frames in, one table of columns per message out, in the units of the database."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from enum import IntEnum
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from cantools.database.can import Message
from cantools.database.can.signal import Signal

from canlog.arrays import BoolArray, FloatArray, Int64Array
from canlog.database.addressing import (
    FIRST_FAST_GROUP,
    NOBODY,
    AddressBook,
    address_book,
    find_slots,
    message_address,
    overwritten,
    parameter_group,
    rows_by_slot,
)
from canlog.database.not_available import no_value_codes
from canlog.decode.compiled import decode_block, signal_rules
from canlog.decode.signals import Decoded, PayloadWords, SignalTable, compile_signal
from canlog.errors import DefinitionError
from canlog.frames import ERROR_FLAG, FD_FLAG, FD_PAYLOAD_BYTES, PAYLOAD_BYTES, REMOTE_FLAG, FrameBatch
from canlog.jit import is_numba_loaded


class SignalBlock:
    """The signals of a message, compiled.

    Plain signals that are in every frame are scaled together; all others are decoded by their own tables.
    """

    def __init__(self, tables: Mapping[str, SignalTable]) -> None:
        plain = {name: table for name, table in tables.items() if table.is_plain and not table.selectors}
        row_of = {name: row for row, name in enumerate(plain)}
        self._signals = [(name, table, row_of.get(name)) for name, table in tables.items()]
        self._rules = signal_rules([tuple(plain.values())])
        columns = ("left", "right", "sign", "scale", "offset")
        self._beside = {name: self._rules.signal[name].reshape(-1, 1) for name in columns}  # of rows of numbers
        self._starts = [(int(first_byte), bool(is_big)) for first_byte, is_big in self._rules.word]

    def decode(self, words: PayloadWords) -> dict[str, Decoded]:
        raw, value = self.plain_values(words, by_kernel=is_numba_loaded())
        signals: dict[str, Decoded] = {}
        for name, table, row in self._signals:
            if row is None:
                signals[name] = table.decode(words)
            else:
                signals[name] = table.judged(value[row], raw[row]) if table.is_checked else Decoded(value[row], None)
        return signals

    def plain_values(self, words: PayloadWords, *, by_kernel: bool) -> tuple[Int64Array, FloatArray]:
        """Return raw and physical values of the plain signals, shape (m, n) each, bit by bit the same both ways.

        A kernel takes half the time of array operations; to load numba takes a second, which a log of MF4 needs not.
        """
        rules, shape = self._rules, (len(self._rules.signal), len(words))
        raw, value = np.empty(shape, np.int64), np.empty(shape, np.float64)  # no plain signal has 64 bits
        if by_kernel and shape[0]:
            decode_block(words.payloads, words.rows, rules, np.empty(len(words), np.uint64), raw, value)
            return raw, value
        bits, beside = raw.view(np.uint64), self._beside
        for place, number in enumerate(rules.signal["word"].tolist()):
            first_byte, is_big = self._starts[number]
            bits[place] = words.word(first_byte, is_big=is_big)
        bits <<= beside["left"]
        bits >>= beside["right"]
        bits ^= beside["sign"]
        raw -= beside["sign"].view(np.int64)
        np.multiply(raw, beside["scale"], out=value)
        value += beside["offset"]
        return raw, value


class FrameFate(IntEnum):
    """What becomes of a frame; every frame has exactly one fate."""

    DECODED = 0
    SHORT = 1  # shorter than its message: the signals that fit are decoded
    TRANSPORTED = 2  # a piece of a message that is longer than the frame can be, sent by a transport protocol
    WITHOUT_SIGNALS = 3  # of a message of which no signal can be decoded
    UNKNOWN = 4  # not in the database
    REMOTE = 5
    ERROR = 6
    LEFT_OUT = 7  # of a message, or of a time, that was not asked for


HAS_VALUES: Final = (FrameFate.DECODED, FrameFate.SHORT)


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageTable:
    """A message, compiled; ``refused`` says why a signal cannot be decoded.

    Signals are known by their names; of several of one name in a message the later ones have a number: ``Name#2``.
    """

    message: Message
    signals: Mapping[str, SignalTable]
    refused: Mapping[str, str]
    definitions: Mapping[str, Signal]  # of all signals, decoded or refused
    needed_bytes: int  # what a frame must have room for to hold the message; 0: its frames do, as the database says


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageValues:
    """Frames of one message in a batch, and what its signals say; short frames come apart, by their length."""

    slot: int  # place of the message in the codec
    rows: Int64Array  # (k,) of the batch, rising
    signals: Mapping[str, Decoded]  # (k,) each
    cut_off: Mapping[str, int]  # values that lie behind the end of short frames
    words: PayloadWords


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameMatch:
    """Which message each frame of a batch is, and what becomes of the frames of each message."""

    slot: Int64Array  # (n,) NOBODY where no signal can be decoded
    counts: Int64Array  # (messages + 1, fates), in the last row frames of no message


class SlotRules(NamedTuple):
    """Which frames of each message can be decoded, arrays of shape (messages + 1,); the last is for no message."""

    min_length: Int64Array
    needed_bytes: Int64Array  # as of MessageTable
    fate: Int64Array  # of frames that are long enough


class Codec:
    """The messages of a database as tables: every sender of a J1939 parameter group, every channel.

    Of messages with one identifier the last one counts, as in cantools; ``overwritten`` has the others and the last.
    Values outside a signal's [min|max] are invalid if ``check_range``, codes that say "not available" by their place in
    the scale if ``check_codes``.
    """

    def __init__(self, messages: Sequence[Message], *, check_range: bool = True, check_codes: bool = False) -> None:
        addresses = [message_address(message) for message in messages]
        later = overwritten(addresses)
        self.overwritten = tuple((messages[old], messages[new]) for old, new in later.items())
        effective = [slot for slot in range(len(messages)) if slot not in later]
        self.tables = tuple(
            message_table(messages[slot], check_range=check_range, check_codes=check_codes) for slot in effective
        )
        self._blocks: dict[tuple[int, int], SignalBlock] = {}  # by slot and bytes of the frame
        self._book = address_book([addresses[slot] for slot in effective])
        self._rules = _slot_rules(self.tables, self._book)
        self._is_left_out: BoolArray | None = None  # (messages,) none of its signals was asked for

    def only(self, places: Collection[tuple[int, str]]) -> "Codec":
        """Return a codec with the same slots that decodes some signals, given by slot and name, and no others."""
        chosen = copy(self)
        chosen.tables = tuple(
            replace(
                table,
                signals={name: signal for name, signal in table.signals.items() if (slot, name) in places},
                refused={name: why for name, why in table.refused.items() if (slot, name) in places},
            )
            for slot, table in enumerate(self.tables)
        )
        is_left_out = np.array(
            [bool(old.signals) and not new.signals for old, new in zip(self.tables, chosen.tables, strict=True)],
            np.bool_,
        )
        chosen._blocks = {}  # noqa: SLF001 - of the copy
        chosen._rules = _slot_rules(chosen.tables, self._book)  # noqa: SLF001 - likewise
        chosen._rules.needed_bytes[:-1][is_left_out] = 0  # noqa: SLF001 - pieces of what is not asked for are no loss
        chosen._is_left_out = is_left_out  # noqa: SLF001 - likewise
        return chosen

    def match(self, batch: FrameBatch) -> FrameMatch:
        """Return the message of each frame, NOBODY where no signal can be decoded, and the fates of frames."""
        slot = find_slots(self._book, batch.can_id)
        fate = _fates(self._rules, batch, slot)
        shape = len(self.tables) + 1, len(FrameFate)
        place = np.where(slot == NOBODY, len(self.tables), slot) * len(FrameFate) + fate
        counts = np.bincount(place, minlength=shape[0] * shape[1]).reshape(shape)
        if self._is_left_out is not None:
            counts[:-1][self._is_left_out] = 0
            counts[-1, FrameFate.LEFT_OUT] = len(batch) - counts.sum()
        slot[fate > FrameFate.SHORT] = NOBODY
        return FrameMatch(slot=slot, counts=counts)

    def slots_of(self, can_ids: Sequence[int]) -> Int64Array:
        """Return the message that each identifier, with its flags, is of; NOBODY if of none."""
        return find_slots(self._book, np.array(can_ids, np.uint32))

    def decode(self, batch: FrameBatch, match: FrameMatch | None = None) -> Iterator[MessageValues]:
        """Yield the messages that are in a batch, in the order of the codec."""
        match = match or self.match(batch)
        lengths, short_counts = self._rules.min_length.tolist(), match.counts[:-1, FrameFate.SHORT].tolist()
        payloads = PayloadWords(batch.data)
        for slot, rows in rows_by_slot(match.slot, len(self.tables)):
            if not short_counts[slot]:
                yield self._values(payloads.at(rows), slot, rows, lengths[slot])
                continue
            sizes = np.minimum(batch.length[rows], lengths[slot])
            for size in sorted(set(sizes.tolist()), key=lambda size: (size < lengths[slot], size)):
                these = rows[sizes == size]
                yield self._values(payloads.at(these), slot, these, size)

    def _values(self, words: PayloadWords, slot: int, rows: Int64Array, size: int) -> MessageValues:
        """Return the signals that lie in payloads of some size, and how many values lie behind their end."""
        tables = self.tables[slot].signals
        if (slot, size) not in self._blocks:
            self._blocks[slot, size] = SignalBlock(
                {name: signal for name, signal in tables.items() if signal.needed_bytes <= size}
            )
        signals = self._blocks[slot, size].decode(words)
        cut_off: dict[str, int] = {}
        if len(signals) < len(tables):
            cut_off = {name: table.cut_off_count(words, size) for name, table in tables.items() if name not in signals}
        return MessageValues(slot=slot, rows=rows, signals=signals, cut_off=cut_off, words=words)


def _slot_rules(tables: Sequence[MessageTable], book: AddressBook) -> SlotRules:
    min_length = np.array([*(min(table.message.length, FD_PAYLOAD_BYTES) for table in tables), 0], np.int64)
    needed_bytes = np.array([*(table.needed_bytes for table in tables), 0], np.int64)
    groups = np.array([parameter_group(table.message.frame_id) for table in tables], np.int64)
    needed_bytes[:-1][(book.is_group != 0) & (groups < FIRST_FAST_GROUP)] = 0  # pieces have another identifier
    fates = [FrameFate.DECODED if table.signals else FrameFate.WITHOUT_SIGNALS for table in tables]
    return SlotRules(min_length, needed_bytes, np.array([*fates, FrameFate.UNKNOWN], np.int64))


def _fates(rules: SlotRules, batch: FrameBatch, slot: Int64Array) -> Int64Array:
    """Return what becomes of frames, shape (n,), whose messages are known, NOBODY for none."""
    fate = rules.fate[slot]
    fate[(fate == FrameFate.DECODED) & (batch.length < rules.min_length[slot])] = FrameFate.SHORT
    if rules.needed_bytes.any():
        is_long = (batch.flags & np.uint8(FD_FLAG) != 0) | (batch.length > PAYLOAD_BYTES)  # not every log tells CAN FD
        room = np.where(is_long, FD_PAYLOAD_BYTES, PAYLOAD_BYTES)
        fate[rules.needed_bytes[slot] > room] = FrameFate.TRANSPORTED
    fate[batch.can_id & np.uint32(REMOTE_FLAG) != 0] = FrameFate.REMOTE
    fate[batch.can_id & np.uint32(ERROR_FLAG) != 0] = FrameFate.ERROR
    return fate


def message_table(message: Message, *, check_range: bool = True, check_codes: bool = False) -> MessageTable:
    """Return a message with all its signals compiled that can be."""
    signals: dict[str, SignalTable] = {}
    refused: dict[str, str] = {}
    definitions = _labelled(message.signals)
    for name, signal in definitions.items():
        codes = no_value_codes(message, signal) if check_codes else ()
        try:
            signals[name] = compile_signal(message, signal, check_range=check_range, codes=codes)
        except DefinitionError as error:
            refused[name] = str(error)
    return MessageTable(
        message=message,
        signals=MappingProxyType(signals),
        refused=MappingProxyType(refused),
        definitions=MappingProxyType(definitions),
        needed_bytes=0 if message.length <= (FD_PAYLOAD_BYTES if message.is_fd else PAYLOAD_BYTES) else message.length,
    )


def _labelled(signals: Sequence[Signal]) -> dict[str, Signal]:
    names = {signal.name for signal in signals}
    labelled: dict[str, Signal] = {}
    for signal in signals:
        name, number = signal.name, 1
        while name in labelled or (number > 1 and name in names):
            number += 1
            name = f"{signal.name}#{number}"
        labelled[name] = signal
    return labelled
