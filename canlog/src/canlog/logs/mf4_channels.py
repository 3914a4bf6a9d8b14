"""Measured channels of ASAM MDF 4 files as a table of signals: what a bench or a calibration tool recorded.

Which channels there are is told by the file's own blocks, so that asammdf is loaded only where values are read. Each
group has its own times. Values that are marked as invalid are none.
"""

import os
from collections.abc import Iterator, Sequence
from typing import Any, BinaryIO, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray, UInt32Array
from canlog.database.signal_columns import SignalColumn, column_id
from canlog.errors import SourceError
from canlog.frames import EXTENDED_FLAG, NS_PER_US, FrameBatch
from canlog.logs.log_counts import LogCounts
from canlog.logs.mf4_blocks import UNFINISHED_MAGIC, MeasuredGroup, Mf4File, UnknownStructureError
from canlog.logs.signal_tables import checked_rows, signal_columns
from canlog.logs.streams import FREE_BYTES, MOST_RATIO

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
