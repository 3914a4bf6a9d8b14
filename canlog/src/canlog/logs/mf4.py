"""ASAM MDF 4 through asammdf, an optional and heavy dependency: frames of buses, or measured channels as signals.

Which channels there are is told by the file's own blocks, so that asammdf is loaded only where values are read. Each
group has its own times: floating-point seconds from the start in the file, rounded to whole microseconds here. Values
that are marked as invalid are none.
"""

import logging
import os
import re
import shutil
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from html import unescape
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray, Records, UInt8Array, UInt32Array
from canlog.database.signal_columns import SignalColumn, column_id
from canlog.errors import SourceError
from canlog.extras import load_asammdf
from canlog.frames import (
    BRS_FLAG,
    ERROR_FLAG,
    ESI_FLAG,
    EXTENDED_FLAG,
    FD_FLAG,
    FD_PAYLOAD_BYTES,
    NS_PER_US,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    TX_FLAG,
    FrameBatch,
    clear_padding,
    merged_by_time,
    rounded_to_us,
)
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.signal_tables import checked_rows, signal_columns
from canlog.logs.streams import FREE_BYTES, MOST_RATIO
from canlog.logs.text_kernels import IS_LENGTH

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
FIELDS = struct.Struct("<BBB")  # of a channel: role in its group, quantity of a master, kind of number
MASTERS, TIME, NUMBERS = {2, 3}, 1, range(6)
UNIT_OF_CONVERSION, FIRST_REFERENCE = 1, 4  # links of a conversion
FORMULA, TO_NUMBERS = 3, range(9)  # kinds of conversion; the last two name numbers in words, which are left alone
SAFE_FORMULA = re.compile(r"[-+*/(). \dEeX]{1,200}")
PLAIN_BUS_EVENTS = 0x0004  # flag of a channel group: its records are frames; those of signals decoded of them lack it
BUS_FRAMES = re.compile(r"(?:CAN|LIN|FLX|ETH|MOST|KLINE|K)_?\w*(?:Frame|Error|Event|Message)\w*")
WORD_BYTES = 8
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
        groups, count = list[MeasuredGroup](), 0
        for data in self._chain(self._need(FIRST_BLOCK, b"##HD").links[0], b"##DG", MOST_CHANNELS):
            count += 1
            for group in self._chain(data.links[1], CHANNEL_GROUP, MOST_CHANNELS - count):
                _, cycles, flags, _, _, _ = GROUP.unpack(self._bytes(group.body_at, GROUP.size))
                blocks = list(self._chain(group.links[1], CHANNEL, MOST_CHANNELS - count))
                count += 1 + len(blocks)
                if (cycles or self._is_unfinished) and not flags & VARIABLE_LENGTH:
                    groups.append(self._measured(group, flags, blocks))
        return groups

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
        is_bus = bool(flags & PLAIN_BUS_EVENTS) or any(BUS_FRAMES.fullmatch(name) for name in others)
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
            match = TEXT_IN_XML.search(text)
            text = unescape(match[1]) if match else ""
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
        block_kind, length, links = HEADER.unpack(self._bytes(at, HEADER.size))
        is_block = block_kind[:2] == b"##" and block_kind[2:].isalpha() and links <= MOST_LINKS
        if not is_block or (kind is not None and block_kind != kind):
            raise UnknownStructureError(f"no block at byte {at}")
        addresses = self._bytes(at + HEADER.size, LINK.size * links)
        return Block(
            kind=block_kind, at=at, length=length, links=tuple(address for (address,) in LINK.iter_unpack(addresses))
        )

    def _bytes(self, at: int, count: int) -> bytes:
        if at < 0 or at + count > self.size_bytes:
            raise UnknownStructureError(f"the file ends before byte {at + count}")
        self._stream.seek(at)
        return self._stream.read(count)


CELLS: Final = 250_000  # that are read at once
Untyped = Any  # asammdf's own objects


class Measured(NamedTuple):
    """The groups of a file that are tables, the columns of all of them, and notes for people."""

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
    tables = tuple(group for group in groups if group.channels and group.has_times and not group.is_bus)
    count = sum(len(group.channels) for group in tables)
    if any(group.is_bus for group in groups):
        return Measured(notes=(f"{count} measured channels beside the frames of buses are left out",) * bool(count))
    channels = [channel for group in tables for channel in group.channels]
    columns, notes = signal_columns([channel.name for channel in channels], [channel.unit for channel in channels])
    others = [name for group in groups for name in group.others]
    others += [channel.name for group in groups if not group.has_times for channel in group.channels]
    notes += [f"channels without numbers or without times are left out: {', '.join(others)}"] * bool(others)
    return Measured(tables, tuple(columns), tuple(notes))


def channel_batches(
    mdf: Untyped, measured: Measured, size_bytes: int, start_ns: int, counts: LogCounts
) -> list[Iterator[FrameBatch]]:
    """Return the values of each group as frames, of a file that was opened as a stream.

    Raises SourceError if they are packed as no measurement is.
    """
    places = {group.channel_group.address: number for number, group in enumerate(mdf.groups)}
    heads = [mdf.groups[places[group.at]].channel_group for group in measured.groups]
    if sum(head.cycles_nr * head.samples_byte_nr for head in heads) > FREE_BYTES + MOST_RATIO * size_bytes:
        raise SourceError(f"the MF4 file holds more than {MOST_RATIO} times its size: no measurement does")
    ids = np.array([column_id(signal_column.name) | EXTENDED_FLAG for signal_column in measured.columns], np.uint32)
    streams, first = list[Iterator[FrameBatch]](), 0
    for group in measured.groups:
        group_ids = ids[first : first + len(group.channels)]
        first += len(group.channels)
        streams.append(
            _group(mdf, places[group.at], [channel.at for channel in group.channels], group_ids, start_ns, counts)
        )
    return streams


def _group(
    mdf: Untyped, number: int, addresses: Sequence[int], ids: UInt32Array, start_ns: int, counts: LogCounts
) -> Iterator[FrameBatch]:
    group, done = mdf.groups[number], 0
    index = {channel.address: place for place, channel in enumerate(group.channels)}
    wanted, stated = [(None, number, index[address]) for address in addresses], int(group.channel_group.cycles_nr)
    coded = [place for place, address in enumerate(addresses) if _has_codes(group.channels[index[address]].conversion)]
    while done < stated:
        count = min(max(1, CELLS // len(wanted)), stated - done)
        signals = mdf.select(
            wanted, record_offset=done, record_count=count, copy_master=False, ignore_value2text_conversions=True
        )
        for place in coded:  # else codes would be numbers, and the numbers would not be scaled
            signals[place] = mdf.select([wanted[place]], record_offset=done, record_count=count, copy_master=False)[0]
        elapsed_us = np.asarray(signals[0].timestamps, np.float64) * 1e6
        time_us = start_ns // NS_PER_US + np.rint(elapsed_us + start_ns % NS_PER_US / NS_PER_US)
        if not len(time_us):
            counts.cut_off(f"record {done + 1} of group {number}", stated - done)
            return
        done += len(time_us)
        numbers = [_numbers(signal, f"group {number}, channel {signal.name!r}") for signal in signals]
        yield checked_rows(time_us, np.column_stack(numbers), ids, counts)


def _has_codes(conversion: Untyped) -> bool:
    """Return whether some values of a channel are words, and the others are scaled by a formula."""
    blocks = getattr(conversion, "referenced_blocks", None) or {}
    scale = getattr(blocks.get("default_addr"), "convert", None)
    if scale is None or not any(isinstance(block, bytes) for block in blocks.values()):
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
    array = np.asarray(values)
    if array.dtype.kind not in kinds or array.size != len(array):
        raise SourceError(f"{place}: not one number for each record, but {array.dtype} of shape {array.shape[1:]}")
    return array.reshape(-1)


IntegerArray = npt.NDArray[np.integer[Any]]

FRAMES_PER_READ = 262_144
NS_PER_S = 1e9
MAX_STANDARD_ID, MAX_ID = 0x7FF, 0x1FFF_FFFF
DATA, REMOTE, ERROR = "CAN_DataFrame", "CAN_RemoteFrame", "CAN_ErrorFrame"
FLAG_OF_KIND = {DATA: 0, REMOTE: REMOTE_FLAG, ERROR: ERROR_FLAG}
LAST_S = 9.2e9
NEEDS_ASAMMDF = "MF4 needs the optional package asammdf"

# What asammdf lets through when blocks point nowhere or hold nonsense.
DAMAGE = (OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, struct.error, zlib.error,
          NameError, RuntimeError, MemoryError)  # fmt: skip


def read_mf4(stream: BinaryIO, counts: LogCounts) -> Iterator[FrameBatch]:
    """Yield the frames of all CAN groups of an MDF 4 file, else its measured channels, merged by time.

    Raises SourceError if asammdf is not installed, or the file is damaged or not of version 4.
    """
    asammdf, errors = quiet_asammdf()
    path = Path(stream.name)
    size_bytes = path.stat().st_size
    with TemporaryDirectory(prefix="clutchdiag-") as folder:
        try:
            yield from _batches(asammdf, path, Path(folder), counts)
        except errors as exc:
            if path.stat().st_size < size_bytes:
                counts.cut_off("where the file shrank while it was read")
                return
            raise SourceError(f"the MF4 file is damaged or cut off: {' '.join(str(exc).split())}") from exc


def _batches(asammdf: Untyped, path: Path, folder: Path, counts: LogCounts) -> Iterator[FrameBatch]:
    mdf: Untyped = None
    try:
        with path.open("rb") as original:
            measured = measured_channels(original)
            is_unfinished = counts.unfinished = original.read(len(UNFINISHED_MAGIC)) == UNFINISHED_MAGIC
        if is_unfinished:  # asammdf completes it where it is
            path = Path(shutil.copy(path, folder / "unfinished.mf4"))
        # A stream is read in pieces; a path would be mapped, and a mapped file that shrinks ends the program.
        with path.open("r+b" if is_unfinished else "rb") as opened:
            mdf = asammdf.MDF(opened, process_bus_logging=False, temporary_folder=folder)
            start_ns = int(mdf.header.abs_time)
            if mdf.header.start_time.tzinfo is None:  # a local time without a zone counts as this machine's
                start_ns = int(mdf.header.start_time.timestamp()) * int(NS_PER_S) + start_ns % int(NS_PER_S)
            kinds = {number: kind for number, group in enumerate(mdf.groups) if (kind := frame_kind(group))}
            streams = [read_group(mdf, number, kind, start_ns, counts) for number, kind in kinds.items()]
            if measured.groups:
                streams = channel_batches(mdf, measured, path.stat().st_size, start_ns, counts)
            for batch in merged_by_time(streams):
                counts.frames += len(batch)
                yield batch
    finally:
        if mdf is not None:
            end_quietly(mdf)


def quiet_asammdf() -> tuple[Untyped, tuple[type[Exception], ...]]:
    """Return asammdf, made to keep to raising errors, and what it raises of a damaged file.

    Raises ExtraMissingError if it is not installed.
    """
    asammdf = load_asammdf(NEEDS_ASAMMDF)
    # For a damaged file it logs tracebacks, and its destructor prints one more.
    logging.getLogger("asammdf").setLevel(logging.CRITICAL)
    asammdf.blocks.mdf_v4.MDF4.__del__ = end_quietly
    errors = [asammdf.blocks.utils.MdfException, *DAMAGE]
    with suppress(ImportError):
        errors.append(import_module("isal.igzip_lib").IsalError)  # it inflates with it where it is installed
    return asammdf, tuple(errors)


def end_quietly(mdf: Untyped) -> None:
    """Close an MDF object that may lack what its constructor did not come to."""
    with suppress(AttributeError, OSError):
        mdf.close()


def frame_kind(group: Untyped) -> str | None:
    """Return which kind of CAN frames a group holds, None if it holds something else or nothing."""
    names = {channel.name for channel in group.channels}
    if not group.channel_group.cycles_nr:
        return None
    return next((kind for kind in FLAG_OF_KIND if kind in names), None)


def read_group(mdf: Untyped, number: int, kind: str, start_ns: int, counts: LogCounts) -> Iterator[FrameBatch]:
    """Yield the frames of one group; what is missing at its end is counted."""
    stated, done = int(mdf.groups[number].channel_group.cycles_nr), 0
    check_records(mdf, number)
    while done < stated:
        signal = mdf.get(
            kind, group=number, raw=False, record_offset=done, record_count=min(FRAMES_PER_READ, stated - done)
        )
        if not len(signal.samples):
            counts.cut_off(f"record {done + 1} of group {number}", stated - done)
            return
        try:
            batch, is_frame = frames_of(signal.samples, np.asarray(signal.timestamps, np.float64), kind, start_ns)
        except (SourceError, *DAMAGE) as exc:
            raise SourceError(f"group {number}, {kind}: {exc}") from exc
        bad = np.flatnonzero(~is_frame)
        if len(bad):
            counts.reject(LogReject.MALFORMED, f"record {done + int(bad[0]) + 1} of group {number}", len(bad))
        done += len(signal.samples)
        yield batch[is_frame] if len(bad) else batch


def check_records(mdf: Untyped, number: int) -> None:
    """Raise SourceError if a channel lies outside its records by more than a word: asammdf would crash there."""
    group = mdf.groups[number]
    end = group.channel_group.samples_byte_nr + group.channel_group.invalidation_bytes_nr + WORD_BYTES
    for channel, layout in zip(group.channels, mdf._mdf._prepare_record(group), strict=True):  # noqa: SLF001 - it alone knows
        if layout is None or layout[0].names:  # of several, each of which is checked
            continue
        _, size, first, _ = layout
        if not 0 <= first <= first + size < end:
            raise SourceError(f"group {number}: channel {channel.name!r} lies outside its records")


def frames_of(
    samples: Records, elapsed_s: npt.NDArray[np.float64], kind: str, start_ns: int
) -> tuple[FrameBatch, npt.NDArray[np.bool_]]:
    """Return records, with fields such as ``CAN_DataFrame.ID``, as frames, and which of them are frames, shape (n,)."""
    if kind != ERROR and f"{kind}.ID" not in (samples.dtype.names or ()):
        raise SourceError("no channel holds the identifiers")
    number = column(samples, kind, "ID").astype(np.uint32) & np.uint32(MAX_ID)
    is_extended = column(samples, kind, "IDE") != 0
    is_fd = column(samples, kind, "EDL") != 0
    stored = column(samples, kind, "DataLength" if kind == DATA else "DLC")
    is_time = np.isfinite(elapsed_s) & (np.abs(elapsed_s) < LAST_S - start_ns / NS_PER_S)
    is_length = (stored >= 0) & (stored <= FD_PAYLOAD_BYTES) & IS_LENGTH[np.clip(stored, 0, FD_PAYLOAD_BYTES)]
    is_fd |= stored > PAYLOAD_BYTES
    is_frame = is_time & ((is_length & (is_extended | (number <= MAX_STANDARD_ID))) | (kind == ERROR))
    length = np.where(is_length & (kind != ERROR), stored, 0).astype(np.uint8)
    can_id = number | np.where(is_extended, np.uint32(EXTENDED_FLAG), np.uint32(0))
    flags = np.where(is_sent(samples, kind), np.uint8(TX_FLAG), np.uint8(0))
    if is_fd.any():
        fast, passive = (column(samples, kind, field) != 0 for field in ("BRS", "ESI"))
        flags |= (is_fd * (FD_FLAG | BRS_FLAG * fast | ESI_FLAG * passive)).astype(np.uint8)
    elapsed_ns = np.rint(np.where(is_time, elapsed_s, 0.0) * NS_PER_S).astype(np.int64)
    batch = FrameBatch(
        t_ns=rounded_to_us(start_ns + elapsed_ns),
        can_id=np.full(len(length), ERROR_FLAG, np.uint32) if kind == ERROR else can_id | np.uint32(FLAG_OF_KIND[kind]),
        length=length,
        data=payloads(samples, kind, length, FD_PAYLOAD_BYTES if is_fd.any() else PAYLOAD_BYTES),
        flags=flags,
        channel=np.clip(column(samples, kind, "BusChannel"), 0, 255).astype(np.uint8),
    )
    return batch, is_frame


def is_sent(samples: Records, kind: str) -> npt.NDArray[np.bool_]:
    """Return which frames the recorder sent itself: a number, or the text that a conversion makes of it."""
    name = f"{kind}.Dir"
    if name not in (samples.dtype.names or ()):
        return np.zeros(len(samples), np.bool_)
    values = one_each(samples[name], "bSiuf", name)
    sent: npt.NDArray[np.bool_] = (np.char.lower(values) == b"tx") if values.dtype.kind == "S" else values == 1
    return sent


def column(samples: Records, kind: str, field: str) -> IntegerArray:
    """Return one field of the records as integers, zeros if the records lack it."""
    name = f"{kind}.{field}"
    if name not in (samples.dtype.names or ()):
        return np.zeros(len(samples), np.uint8)
    values = one_each(samples[name], "biuf", name)
    return values if values.dtype.kind == "u" else values.astype(np.int64)


def payloads(samples: Records, kind: str, length: UInt8Array, width: int) -> UInt8Array:
    """Return the payload bytes (n, width), zeros where there are none."""
    data = np.zeros((len(samples), width), np.uint8)
    name = f"{kind}.DataBytes"
    if kind == DATA and name in (samples.dtype.names or ()):
        if samples[name].dtype != np.uint8:
            raise SourceError(f"{name}: not bytes, but {samples[name].dtype}")
        stored = samples[name].reshape(len(samples), -1)[:, :width]
        data[:, : stored.shape[1]] = stored
    return data if (length == width).all() else clear_padding(data, length)
