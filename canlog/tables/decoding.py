"""Logs to tables: one pass from frames to columns and the account of what is not in them, for files and for memory."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
from cantools.database.can import Message

from canlog.decode.codec import HAS_VALUES, Codec, MessageValues
from canlog.errors import OutputError
from canlog.frames import FrameBatch
from canlog.logs import LogReader, read_log
from canlog.parquet_file import ParquetTable
from canlog.tables.account import DecodeAccount
from canlog.tables.layouts import LongLayout, Values, WideLayout
from canlog.tables.names import TableNames, table_names

MAX_CELLS: Final = 4_000_000  # of a row group: 32 MB of numbers
CELLS_PER_FRAME: Final = 64  # of the long table, at most as a rule


class TableShape(StrEnum):
    """What a row of a table is."""

    WIDE = "wide"  # a frame
    LONG = "long"  # a value


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What is decoded, and how it is written."""

    codec: Codec
    names: TableNames
    shape: TableShape = TableShape.WIDE
    values: Values = Values.NUMBERS
    max_cells: int = MAX_CELLS  # of a row group

    @classmethod
    def of(
        cls, messages: Sequence[Message], shape: TableShape = TableShape.WIDE, values: Values = Values.NUMBERS
    ) -> "Plan":
        """Return the plan for the messages of a database."""
        codec = Codec(messages)
        return cls(codec=codec, names=table_names(codec.tables), shape=shape, values=values)

    def layout(self, batches: Callable[[], Iterable[FrameBatch]]) -> WideLayout | LongLayout:
        """Return the columns; for wide rows all frames are looked at, for the messages that occur are the columns."""
        if self.shape is TableShape.LONG:
            return LongLayout(self.codec.tables, self.names, self.values)
        seen: set[int] = set()
        for batch in batches():
            counts = self.codec.match(batch).counts[:-1, list(HAS_VALUES)]
            seen.update(np.flatnonzero(counts.sum(axis=1)).tolist())
        return WideLayout(self.codec.tables, self.names, self.values, sorted(seen))

    def frames_per_group(self, layout: WideLayout | LongLayout) -> int:
        """Return how many frames a row group may hold."""
        cells = CELLS_PER_FRAME if self.shape is TableShape.LONG else len(layout.kinds)
        return max(1, self.max_cells // cells)


def decoded_batches(
    batches: Iterable[FrameBatch], account: DecodeAccount
) -> Iterator[tuple[FrameBatch, list[MessageValues]]]:
    """Yield batches with what their signals say, and enter both into the account."""
    for batch in batches:
        match = account.codec.match(batch)
        found = list(account.codec.decode(batch, match))
        account.add(batch, match)
        for one in found:
            account.add_values(one)
        yield batch, found


def row_groups(
    batches: Iterable[FrameBatch], layout: WideLayout | LongLayout, account: DecodeAccount
) -> Iterator[Mapping[str, Any]]:
    """Yield the columns of one row group for each batch that has any."""
    for batch, found in decoded_batches(batches, account):
        count, columns = layout.columns(batch, found) if found else (0, {})
        if count:
            account.row_count += count
            yield columns


def pieces(batches: Iterable[FrameBatch], size: int) -> Iterator[FrameBatch]:
    """Yield the frames of some batches in batches of at most ``size``."""
    for batch in batches:
        for start in range(0, len(batch), size):
            yield batch[start : start + size]


def decode_log(
    path: Path, plan: Plan, output: Path, is_stopped: Callable[[], bool] = lambda: False
) -> tuple[DecodeAccount, LogReader] | None:
    """Write the signals of a log into a Parquet file in bounded memory; the file appears when it is complete.

    For wide rows the log is read twice.

    Returns
    -------
    tuple of DecodeAccount and LogReader, or None
        What became of every frame, and the reader, which says what the log is; None, and no file, if it was stopped.

    Raises
    ------
    SourceError
        If the log cannot be read.
    OutputError
        If the file cannot be written.
    """
    part = output.with_name(f".{output.name}.part")
    try:
        told = _written(path, plan, part, is_stopped)
        if is_stopped():
            return None
        part.replace(output)
    except OSError as exc:
        raise OutputError(f"cannot write {output}: {exc.strerror or exc}") from exc
    finally:
        part.unlink(missing_ok=True)
    return told


def _written(path: Path, plan: Plan, output: Path, is_stopped: Callable[[], bool]) -> tuple[DecodeAccount, LogReader]:
    layout = plan.layout(lambda: _until(is_stopped, _closed_at_end(path)))
    account = DecodeAccount(codec=plan.codec, names=plan.names)
    with closing(read_log(path)) as reader, ParquetTable(output, layout.kinds, layout.metadata) as table:
        frames = _until(is_stopped, pieces(reader, plan.frames_per_group(layout)))
        for columns in row_groups(frames, layout, account):
            table.write_columns(columns)
        account.log = reader.counts
    return account, reader


def _closed_at_end(path: Path) -> Iterator[FrameBatch]:
    with closing(read_log(path)) as reader:
        yield from reader


def _until(is_stopped: Callable[[], bool], batches: Iterable[FrameBatch]) -> Iterator[FrameBatch]:
    for batch in batches:
        if is_stopped():
            return
        yield batch
