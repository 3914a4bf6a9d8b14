"""Logs to tables: one pass from frames to columns and the account of what is not in them, for files and for memory."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, BinaryIO, Final, Protocol

import numpy as np
from cantools.database.can import Message

from canlog.decode.codec import HAS_VALUES, Codec, MessageValues
from canlog.errors import OutputError
from canlog.frames import FrameBatch
from canlog.logs import LogReader
from canlog.logs.piped import never
from canlog.logs.reading import Watch
from canlog.tables.account import DecodeAccount
from canlog.tables.inputs import LogSet, Origins
from canlog.tables.layouts import LongLayout, Values, WideLayout
from canlog.tables.long_rows import LongRows, Stretch
from canlog.tables.names import TableNames, table_names
from canlog.tables.outputs import TableFormat, open_columns
from canlog.tables.parquet_long import LongParquet
from canlog.tables.parquet_tables import GROUP_FRAMES, GROUP_VALUES, ParquetRows, WideParquet
from canlog.tables.selection import EVERYTHING, Span, chosen_places
from canlog.whole_file import replacing

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
    max_frames: int = GROUP_FRAMES  # of a row group of Parquet
    max_values: int = GROUP_VALUES  # likewise
    span: Span = EVERYTHING
    pairs: tuple[tuple[int, int], ...] = ()  # identifiers of requests and answers, as of ``LongRows``

    @classmethod
    def of(
        cls,
        messages: Sequence[Message],
        shape: TableShape = TableShape.WIDE,
        values: Values = Values.NUMBERS,
    ) -> "Plan":
        """Return the plan for the messages of a database."""
        codec = Codec(messages, has_long=True)
        return cls(codec=codec, names=table_names(codec.tables), shape=shape, values=values)

    def part(self, signals: Sequence[str], begin: str | float | None, end: str | float | None) -> "Plan":
        """Return the plan for some signals, all if none is named, and for the stretch between two times.

        Raises
        ------
        DefinitionError
            If a pattern names no signal.
        SourceError
            If a text is no time.
        """
        span = Span.of(begin, end)
        if not signals:
            return replace(self, span=span)
        return replace(self, span=span, codec=self.codec.only(chosen_places(self.names.columns, signals)))

    def layout(
        self, batches: Callable[[], Iterable[FrameBatch]], origins: Origins | None = None
    ) -> WideLayout | LongLayout:
        """Return the columns; for wide rows all frames are looked at, for the messages that occur are the columns."""
        if self.shape is TableShape.LONG:
            return LongLayout(self.codec.tables, self.names, self.values, origins)
        seen: set[int] = set()
        together = LongRows(self.codec, self.pairs)
        for stretch in together.stretches(batches()):
            counts = stretch.match.counts[:-1, list(HAS_VALUES)]
            seen.update(np.flatnonzero(counts.sum(axis=1)).tolist())
        seen.update(together.counts_of)
        return WideLayout(self.codec.tables, self.names, self.values, sorted(seen), origins)

    def frames_per_group(self, layout: WideLayout | LongLayout) -> int:
        """Return how many frames a row group may hold."""
        cells = CELLS_PER_FRAME if self.shape is TableShape.LONG else len(layout.kinds)
        return max(1, self.max_cells // cells)


def stretches(
    batches: Iterable[FrameBatch], account: DecodeAccount, pairs: Collection[tuple[int, int]] = ()
) -> Iterator[Stretch]:
    """Yield frames with their messages, and with those messages that several frames are; all enter the account."""
    together = LongRows(account.codec, pairs)
    account.transfers, account.long_counts = together.counts, together.counts_of
    for stretch in together.stretches(batches):
        account.add(stretch)
        yield stretch


def decoded_batches(
    batches: Iterable[FrameBatch], account: DecodeAccount, pairs: Collection[tuple[int, int]] = ()
) -> Iterator[tuple[FrameBatch, list[MessageValues]]]:
    """Yield batches with what their signals say, and enter both into the account.

    Among the frames is a row for each message that several frames are.
    """
    codec = account.codec
    for stretch in stretches(batches, account, pairs):
        found = list(codec.decode(stretch.batch, replace(stretch.match, slot=stretch.slot)))
        if stretch.long is not None:
            found += stretch.long.values(codec)
        for one in found:
            account.add_values(one)
        yield stretch.batch, found


def row_groups(
    batches: Iterable[FrameBatch],
    layout: WideLayout | LongLayout,
    account: DecodeAccount,
    pairs: Collection[tuple[int, int]] = (),
) -> Iterator[Mapping[str, Any]]:
    """Yield the columns of one row group for each batch that has any."""
    for batch, found in decoded_batches(batches, account, pairs):
        count, columns = layout.columns(batch, found) if found else (0, {})
        if count:
            account.row_count += count
            yield columns


def pieces(batches: Iterable[FrameBatch], size: int) -> Iterator[FrameBatch]:
    """Yield the frames of some batches in batches of at most ``size``."""
    for batch in batches:
        for start in range(0, len(batch), size):
            yield batch[start : start + size]


@dataclass(frozen=True, slots=True, kw_only=True)
class Decoded:
    """What became of some logs."""

    account: DecodeAccount
    readers: tuple[LogReader, ...]  # in the order in which the logs were named; closed
    is_whole: bool  # False: it was stopped


class TableSink(Protocol):
    """What takes decoded frames."""

    def write(self, batch: FrameBatch, found: Sequence[MessageValues]) -> int:
        """Take a batch and what its signals say; return how many rows that made."""

    def close(self) -> None:
        """Write what the format needs at its end."""

    def discard(self) -> None:
        """Leave what there is: it is not complete."""


class _Rows:
    """Rows of columns into any file of columns."""

    def __init__(self, output: BinaryIO, table_format: TableFormat, layout: WideLayout | LongLayout) -> None:
        self._layout = layout
        self._columns = open_columns(output, table_format, layout.kinds, layout.metadata)

    def write(self, batch: FrameBatch, found: Sequence[MessageValues]) -> int:
        count, columns = self._layout.columns(batch, found) if found else (0, {})
        if count:
            self._columns.write_columns(columns)
        return count

    def close(self) -> None:
        self._columns.close()

    def discard(self) -> None:
        self._columns.discard()


def decode_logs(
    paths: Sequence[Path],
    plan: Plan,
    output: Path | BinaryIO,
    table_format: TableFormat,
    is_stopped: Callable[[], bool] = never,
    watch: Watch | None = None,
    columns: str = "",
) -> Decoded:
    """Write the signals of logs, merged by time, in bounded memory; a file appears when it is complete.

    For wide rows the logs are read twice, so standard input is kept in a file first. ``columns`` says which column of a
    text is which, as ``read_log`` takes it.

    Raises
    ------
    SourceError
        If a log cannot be read.
    OutputError
        If the file cannot be written.
    ExtraMissingError
        If the library that writes the format is not installed.
    """

    def written(stream: BinaryIO) -> Decoded:
        is_read_twice = _is_read_twice(plan, table_format)
        with LogSet(paths, is_stopped, is_read_twice=is_read_twice, watch=watch, columns=columns) as logs:
            return _written(logs, plan, stream, table_format, is_stopped)

    if isinstance(output, Path):
        with replacing(output, OutputError) as part:
            with part.open("wb+") as stream:
                decoded = written(stream)
            if decoded.is_whole:
                part.replace(output)
        return decoded
    return written(output)


def _is_read_twice(plan: Plan, table_format: TableFormat) -> bool:
    """Return whether the columns depend on all of the frames."""
    return table_format not in {TableFormat.MF4, TableFormat.PARQUET} and plan.shape is TableShape.WIDE


def _written(
    logs: LogSet, plan: Plan, output: BinaryIO, table_format: TableFormat, is_stopped: Callable[[], bool]
) -> Decoded:
    account = DecodeAccount(codec=plan.codec, names=plan.names)

    def frames(left_out: Callable[[int], None] = account.leave_out) -> Iterator[FrameBatch]:
        return plan.span.part(_until(is_stopped, logs.frames()), left_out)

    if table_format is TableFormat.PARQUET:
        table = _parquet(plan, output, account, logs.origins)
        is_whole = _write_parquet(stretches(frames(), account, plan.pairs), table, is_stopped)
    else:
        if table_format is TableFormat.MF4:
            from canlog.tables.mf4_table import Mf4Table  # noqa: PLC0415 - for this format alone

            sink: TableSink = Mf4Table(output, plan.codec, plan.names, logs.origins)
            size = plan.max_cells // CELLS_PER_FRAME
        else:
            layout = plan.layout(lambda: frames(_uncounted), logs.origins)
            sink, size = _Rows(output, table_format, layout), plan.frames_per_group(layout)
        is_whole = _write(decoded_batches(pieces(frames(), size), account, plan.pairs), sink, account, is_stopped)
    account.log = logs.counts
    account.leave_out(max(0, account.log.frames - sum(account.fates.values())))  # behind the end that was asked for
    return Decoded(account=account, readers=tuple(logs.readers), is_whole=is_whole)


def _write(
    decoded: Iterable[tuple[FrameBatch, list[MessageValues]]],
    sink: TableSink,
    account: DecodeAccount,
    is_stopped: Callable[[], bool],
) -> bool:
    """Write frames into any format; return whether all are."""
    is_whole = False
    try:
        for batch, found in decoded:
            account.row_count += sink.write(batch, found)
        is_whole = not is_stopped()
    finally:
        (sink.close if is_whole else sink.discard)()
    return is_whole


def _parquet(plan: Plan, output: BinaryIO, account: DecodeAccount, origins: Origins | None) -> ParquetRows:
    kind = WideParquet if plan.shape is TableShape.WIDE else LongParquet
    limits = {"most_frames": plan.max_frames, "most_values": plan.max_values}
    return kind(output, account, plan.values, origins, **limits)


def _write_parquet(found: Iterable[Stretch], table: ParquetRows, is_stopped: Callable[[], bool]) -> bool:
    """Write frames into Parquet; return whether all are."""
    for stretch in found:
        table.write(stretch)
    if is_stopped():
        return False
    table.close()
    return True


def _uncounted(_: int) -> None:
    """Count nothing: another pass does."""


def _until(is_stopped: Callable[[], bool], batches: Iterable[FrameBatch]) -> Iterator[FrameBatch]:
    for batch in batches:
        if is_stopped():
            return
        yield batch
