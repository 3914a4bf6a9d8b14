"""Decoded frames as wide Parquet: time and space go by the values that there are, not by the cells."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array, UInt8Array
from canlog.database.addressing import NOBODY
from canlog.decode.carriers import Carriers, CutOff, carriers
from canlog.parquet import contents
from canlog.parquet.column_file import ColumnFile, Levels
from canlog.parquet.packing import Int32Array
from canlog.parquet_file import NAME_TYPE
from canlog.tables.account import DecodeAccount
from canlog.tables.coded_signals import NAMELESS, CodedSignal, coded_signal
from canlog.tables.frame_contents import frame_contents
from canlog.tables.frame_stock import FrameGroup
from canlog.tables.inputs import Origins
from canlog.tables.layouts import Values, WideLayout
from canlog.tables.names import TEXT_SUFFIX, Place

GROUP_FRAMES: Final = 1_048_576  # of a group of rows, at most
GROUP_VALUES: Final = 4_718_592  # likewise


class WideParquet:
    """A row per frame, and a column for each signal of the messages that occur.

    Parameters
    ----------
    file
        What is written to.
    account
        Of what becomes of frames and values; the rows are counted as well.
    layout
        The columns that may occur, and how values are written.
    origins
        Where frames of several logs come from.
    """

    def __init__(
        self, file: ColumnFile, account: DecodeAccount, layout: WideLayout, origins: Origins | None = None
    ) -> None:
        self._file = file
        self._account = account
        self._layout = layout
        self._names = layout.names
        self._values = layout.values
        self._origins = origins

    def write_group(self, group: FrameGroup) -> None:
        """Write frames, a row for each."""
        count = len(group)
        everywhere = self._file.everywhere(count)
        kinds = self._layout.frame_kinds
        for name, content in frame_contents(group, self._names.messages, self._origins, self._file.packer).items():
            self._file.add(name, kinds[name], everywhere, content)
        for one in self._carriers(group):
            levels = self._file.levels(one.frames, count)
            for name in one.signals:
                coded = self._coded(one, name)
                if len(one.frames):
                    self._write_signal((one.slot, name), one.frames, levels, coded)
        self._file.end_group(count)
        self._account.row_count += count

    def _write_signal(self, place: Place, frames: Int64Array, levels: Levels, coded: CodedSignal) -> None:
        """Write the numbers of a signal in some frames, and its texts if they are wanted."""
        column, values, index = self._names.columns[place], coded.values, coded.index
        texts, file = self._layout.texts.get(place), self._file
        if texts is not None and coded.texts is not None:
            code = coded.texts[index]
            is_named = code != NAMELESS
            if is_named.any():
                named = file.levels(frames[is_named], levels.row_count)
                body = file.packer.runs(code[is_named], len(texts.names))
                file.add(column + TEXT_SUFFIX, NAME_TYPE, named, contents.names(texts.names, body))
                if self._values is Values.TEXTS:
                    values, index = without(coded.texts != NAMELESS, values, index)
                    levels = file.levels(frames[~is_named], levels.row_count)
        if levels.present_count:
            file.add(column, "float64", levels, contents.numbers(values, index, file.packer))

    def close(self) -> None:
        """Write the end of the file."""
        kinds, notes = self._layout.described(self._account.seen_slots)
        self._file.close(kinds, notes)

    def discard(self) -> None:
        """Leave what there is: without its end it is no file of this kind."""

    def _carriers(self, group: FrameGroup) -> Iterable[Carriers]:
        """Yield what frames carry; what they have no room for is counted."""
        for rows, slot, data, length in _payloads(group):
            for one in carriers(self._account.codec, slot, data, length):
                if isinstance(one, CutOff):
                    self._account.of_signal(one.slot, one.name).cut_off += one.count
                else:
                    yield one if rows is None else replace(one, frames=rows[one.frames])

    def _coded(self, one: Carriers, name: str) -> CodedSignal:
        """Return a signal, and count its values."""
        texts = self._layout.texts.get((one.slot, name))
        coded = coded_signal(one.signals[name], one.words, self._file.packer, texts)
        counts = self._account.of_signal(one.slot, name)
        counts.values += len(one.frames)
        counts.out_of_range += coded.out_of_range
        counts.not_a_number += coded.not_a_number
        return coded


def _payloads(
    group: FrameGroup,
) -> Iterator[tuple[Int64Array | None, Int64Array, UInt8Array, UInt8Array | Int64Array]]:
    """Yield the rows of payloads, None for all, with their messages, bytes and lengths.

    Messages of which some are longer than a frame come by themselves, with those that a frame of CAN FD held.
    """
    frames, long = group.frames, group.long
    if long is None:
        yield None, group.slot, frames.data, frames.length
        return
    is_long = np.isin(group.slot, long.slot)
    yield None, np.where(is_long, NOBODY, group.slot), frames.data, frames.length
    rows = np.flatnonzero(is_long)
    place = np.searchsorted(rows, long.rows)
    length = frames.length[rows].astype(np.int64)
    length[place] = long.length
    data = np.zeros((len(rows), max(frames.width, long.data.shape[1])), np.uint8)
    data[:, : frames.width] = frames.data[rows]
    data[place, : long.data.shape[1]] = long.data
    yield rows, group.slot[rows], data, length


def without(is_left_out: BoolArray, values: FloatArray, index: Int32Array) -> tuple[FloatArray, Int32Array]:
    """Return different values and which of them each row has, some of these values and their rows left out."""
    new_number = np.cumsum(~is_left_out, dtype=np.int32) - np.int32(1)
    return values[~is_left_out], new_number[index[~is_left_out[index]]]
