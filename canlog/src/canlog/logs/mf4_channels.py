"""Measured channels of ASAM MDF 4 files as a table of signals: what a bench or a calibration tool recorded.

Which channels there are is told by the file's own blocks, so that asammdf is loaded only where values are read. Each
group has its own times. Values that are marked as invalid are none.
"""

import os
import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import unescape
from typing import Any, BinaryIO, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray, UInt32Array
from canlog.database.signal_columns import SignalColumn, column_id
from canlog.errors import SourceError
from canlog.frames import EXTENDED_FLAG, NS_PER_US, FrameBatch
from canlog.logs.log_counts import LogCounts
from canlog.logs.signal_tables import checked_rows, signal_columns
from canlog.logs.streams import FREE_BYTES, MOST_RATIO

HEADER = struct.Struct("<4s4xQQ")  # kind, length with the header, links
LINK = struct.Struct("<Q")
GROUP = struct.Struct("<QQHH4xLL")  # of a channel group: record id, cycles, flags, separator, bytes, invalidation bytes
FIRST_BLOCK = 64
UNFINISHED_MAGIC = b"UnFinMF "
MOST_BLOCKS = 1_000_000
MOST_LINKS = 100_000
VARIABLE_LENGTH = 0x0001  # flag of a channel group: its records begin with their length
CHANNEL, CHANNEL_GROUP = b"##CN", b"##CG"
COMPOSITION, NAME, CONVERSION, UNIT = 1, 2, 4, 6  # which of a channel's links leads there
FIELDS = struct.Struct("<BBB")  # of a channel: what it is to its group, of which quantity a master is, kind of number
MASTERS, TIME, NUMBERS = {2, 3}, 1, range(6)
UNIT_OF_CONVERSION, FIRST_REFERENCE = 1, 4  # links of a conversion
FORMULA, TO_NUMBERS = 3, range(9)  # kinds of conversion; the last two name numbers in words, which are left alone
SAFE_FORMULA = re.compile(r"[-+*/(). \dEeX]{1,200}")
PLAIN_BUS_EVENTS = 0x0004  # flag of a channel group: its records are frames; those of signals decoded of them lack it
BUS_FRAMES = re.compile(r"(?:CAN|LIN|FLX|ETH|MOST|KLINE|K)_?\w*(?:Frame|Error|Event|Message)\w*")
LONGEST_TEXT = 64 * 1024
TEXT_IN_XML = re.compile(r"<TX>(.*?)</TX>", re.DOTALL)
MOST_CHANNELS = 20_000  # with their groups


class UnknownStructureError(Exception):
    """The file is not built as is understood here, or the end of it is missing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """The head of a block."""

    kind: bytes
    at: int
    length: int
    links: tuple[int, ...]

    @property
    def body_at(self) -> int:
        """Where what follows the links is."""
        return self.at + HEADER.size + LINK.size * len(self.links)


class Mf4Channel(NamedTuple):
    """A measured signal that is a number, and where its block is."""

    at: int
    name: str
    unit: str


class MeasuredGroup(NamedTuple):
    """Channels that share their times; ``is_bus`` if its records are frames of a bus."""

    at: int
    channels: tuple[Mf4Channel, ...]
    has_times: bool
    is_bus: bool
    others: tuple[str, ...]  # names of channels that are no numbers, or become such by an unknown formula


class Mf4File:
    """An MDF 4 file."""

    def __init__(self, stream: BinaryIO, size_bytes: int, *, is_unfinished: bool) -> None:
        self._stream = stream
        self.size_bytes = size_bytes
        self._is_unfinished = is_unfinished

    def measured_groups(self) -> list[MeasuredGroup]:
        """Return all groups that have records, with their channels; raises UnknownStructureError."""
        found, count = list[MeasuredGroup](), 0
        for data in self._chain(self._need(FIRST_BLOCK, b"##HD").links[0], b"##DG", MOST_CHANNELS):
            count += 1
            for group in self._chain(data.links[1], CHANNEL_GROUP, MOST_CHANNELS - count):
                _, cycles, flags, _, _, _ = GROUP.unpack(self._bytes(group.body_at, GROUP.size))
                blocks = list(self._chain(group.links[1], CHANNEL, MOST_CHANNELS - count))
                count += 1 + len(blocks)
                if (cycles or self._is_unfinished) and not flags & VARIABLE_LENGTH:
                    found.append(self._measured(group, flags, blocks))
        return found

    def _measured(self, group: Block, flags: int, blocks: list[Block]) -> MeasuredGroup:
        channels, others, has_times = list[Mf4Channel](), list[str](), False
        for block in blocks:
            role, quantity, kind = FIELDS.unpack(self._bytes(block.body_at, FIELDS.size))
            name = self._text(block.links[NAME])
            if role in MASTERS:
                has_times |= quantity == TIME
            elif block.links[COMPOSITION] or kind not in NUMBERS or not self._is_number(block.links[CONVERSION]):
                others.append(name)
            else:
                unit, at = self._text(block.links[UNIT]), block.links[CONVERSION]
                if not unit and at:
                    unit = self._text(self._need(at, b"##CC").links[UNIT_OF_CONVERSION])
                channels.append(Mf4Channel(block.at, name, unit))
        is_bus = bool(flags & PLAIN_BUS_EVENTS) or any(BUS_FRAMES.fullmatch(one) for one in others)
        return MeasuredGroup(group.at, tuple(channels), has_times, is_bus, tuple(others))

    def _is_number(self, conversion_at: int) -> bool:
        if not conversion_at:
            return True
        block = self._need(conversion_at, b"##CC")
        kind = self._bytes(block.body_at, 1)[0]
        if kind == FORMULA:
            return SAFE_FORMULA.fullmatch(self._text(block.links[FIRST_REFERENCE])) is not None
        return kind in TO_NUMBERS

    def _text(self, at: int) -> str:
        """Return the text of a block of text, or the first one in its XML."""
        if not at:
            return ""
        block = self._need(at)
        length = min(block.length - HEADER.size, LONGEST_TEXT, self.size_bytes - block.body_at)
        text = self._bytes(block.body_at, max(length, 0)).partition(b"\0")[0].decode("utf-8", "replace")
        if block.kind == b"##MD":
            found = TEXT_IN_XML.search(text)
            text = unescape(found[1]) if found else ""
        return text.strip()

    def _chain(self, at: int, kind: bytes, most: int = MOST_BLOCKS) -> Iterator[Block]:
        """Yield blocks that are linked by their first links, so many at most; raises SourceError if they are a ring."""
        passed = set[int]()
        while at and len(passed) < most:
            if at in passed:
                raise SourceError("the MF4 file is damaged: its blocks are linked in a ring")
            passed.add(at)
            block = self._need(at, kind)
            yield block
            at = block.links[0]
        if at:
            raise UnknownStructureError("more blocks than are looked at")

    def _need(self, at: int, kind: bytes | None = None) -> Block:
        found, length, links = HEADER.unpack(self._bytes(at, HEADER.size))
        is_block = found[:2] == b"##" and found[2:].isalpha() and links <= MOST_LINKS
        if not is_block or (kind is not None and found != kind):
            raise UnknownStructureError(f"no block at byte {at}")
        addresses = self._bytes(at + HEADER.size, LINK.size * links)
        return Block(kind=found, at=at, length=length, links=tuple(one for (one,) in LINK.iter_unpack(addresses)))

    def _bytes(self, at: int, count: int) -> bytes:
        if at < 0 or at + count > self.size_bytes:
            raise UnknownStructureError(f"the file ends before byte {at + count}")
        self._stream.seek(at)
        return self._stream.read(count)


CELLS: Final = 250_000  # that are read at once
Untyped = Any  # asammdf's own objects


class Measured(NamedTuple):
    """The groups of a file that are a table, the columns of all of them, and what is to be said of it."""

    groups: tuple[MeasuredGroup, ...] = ()
    columns: tuple[SignalColumn, ...] = ()
    notes: tuple[str, ...] = ()


def measured_channels(stream: BinaryIO) -> Measured:
    """Return what a file measured; none if it holds frames of a bus, or blocks that are not understood."""
    try:
        is_unfinished = stream.read(len(UNFINISHED_MAGIC)) == UNFINISHED_MAGIC
        groups = Mf4File(stream, stream.seek(0, os.SEEK_END), is_unfinished=is_unfinished).measured_groups()
    except (UnknownStructureError, IndexError):
        return Measured()
    finally:
        stream.seek(0)
    tables = tuple(one for one in groups if one.channels and one.has_times and not one.is_bus)
    count = sum(len(one.channels) for one in tables)
    if any(one.is_bus for one in groups):
        return Measured(notes=(f"{count} measured channels beside the frames of buses are left out",) * bool(count))
    channels = [channel for one in tables for channel in one.channels]
    columns, notes = signal_columns([one.name for one in channels], [one.unit for one in channels])
    others = [name for one in groups for name in one.others]
    others += [channel.name for one in groups if not one.has_times for channel in one.channels]
    notes += [f"channels without numbers or without times are left out: {', '.join(others)}"] * bool(others)
    return Measured(tables, tuple(columns), tuple(notes))


def channel_batches(
    mdf: Untyped, measured: Measured, size_bytes: int, start_ns: int, counts: LogCounts
) -> list[Iterator[FrameBatch]]:
    """Return the values of each group as frames, of a file that was opened as a stream.

    Raises SourceError if they are packed as no measurement is.
    """
    places = {one.channel_group.address: number for number, one in enumerate(mdf.groups)}
    heads = [mdf.groups[places[one.at]].channel_group for one in measured.groups]
    if sum(one.cycles_nr * one.samples_byte_nr for one in heads) > FREE_BYTES + MOST_RATIO * size_bytes:
        raise SourceError(f"the MF4 file holds more than {MOST_RATIO} times its size: no measurement does")
    ids = np.array([column_id(one.name) | EXTENDED_FLAG for one in measured.columns], np.uint32)
    streams, first = list[Iterator[FrameBatch]](), 0
    for group in measured.groups:
        own = ids[first : first + len(group.channels)]
        first += len(group.channels)
        streams.append(_group(mdf, places[group.at], [one.at for one in group.channels], own, start_ns, counts))
    return streams


def _group(
    mdf: Untyped, number: int, addresses: Sequence[int], ids: UInt32Array, start_ns: int, counts: LogCounts
) -> Iterator[FrameBatch]:
    group, done = mdf.groups[number], 0
    index = {channel.address: place for place, channel in enumerate(group.channels)}
    wanted, stated = [(None, number, index[one]) for one in addresses], int(group.channel_group.cycles_nr)
    coded = [place for place, one in enumerate(addresses) if _has_codes(group.channels[index[one]].conversion)]
    while done < stated:
        count = min(max(1, CELLS // len(wanted)), stated - done)
        found = mdf.select(
            wanted, record_offset=done, record_count=count, copy_master=False, ignore_value2text_conversions=True
        )
        for place in coded:  # else a code were a number in the unit of the others, and the others were not scaled
            found[place] = mdf.select([wanted[place]], record_offset=done, record_count=count, copy_master=False)[0]
        elapsed_us = np.asarray(found[0].timestamps, np.float64) * 1e6
        time_us = start_ns // NS_PER_US + np.rint(elapsed_us + start_ns % NS_PER_US / NS_PER_US)
        if not len(time_us):
            counts.cut_off(f"record {done + 1} of group {number}", stated - done)
            return
        done += len(time_us)
        numbers = [_numbers(one, f"group {number}, channel {one.name!r}") for one in found]
        yield checked_rows(time_us, np.column_stack(numbers), ids, counts)


def _has_codes(conversion: Untyped) -> bool:
    """Return whether some values of a channel are words, and the others are scaled by a formula."""
    blocks = getattr(conversion, "referenced_blocks", None) or {}
    scale = getattr(blocks.get("default_addr"), "convert", None)
    if scale is None or not any(isinstance(one, bytes) for one in blocks.values()):
        return False
    return bool(scale(np.array([1.0, 2.0])).tolist() != [1.0, 2.0])  # else a state, whose codes are its numbers


def _numbers(signal: Untyped, place: str) -> FloatArray:
    """Return the values of a channel, NaN for those that are marked as invalid, and for words."""
    is_word = signal.samples.dtype.kind == "S"
    values: FloatArray = np.full(len(signal.samples), np.nan)
    if not is_word:
        values = np.array(one_each(signal.samples, "biuf", place), np.float64)
    if signal.invalidation_bits is not None:
        values[np.asarray(signal.invalidation_bits, np.bool_)] = np.nan
    return values


def one_each(values: Untyped, kinds: str, place: str) -> npt.NDArray[Any]:
    """Return values of one of these kinds, one for each record; arrays of one are that, too.

    Raises SourceError, which names the place, if they are anything else.
    """
    found = np.asarray(values)
    if found.dtype.kind not in kinds or found.size != len(found):
        raise SourceError(f"{place}: not one number for each record, but {found.dtype} of shape {found.shape[1:]}")
    return found.reshape(-1)
