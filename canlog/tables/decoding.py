"""Logs to tables: one pass from frames to columns and the account of what is not in them, for files and for memory."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
from cantools.database.can import Message

from canlog.decode.codec import HAS_VALUES, Codec
from canlog.errors import OutputError
from canlog.files import replacing
from canlog.frames import FrameBatch
from canlog.logs import STANDARD_INPUT, LogReader
from canlog.logs.piped import never
from canlog.logs.reading import Watch
from canlog.tables.account import DecodeAccount
from canlog.tables.groups import GroupSize, groups, stretches
from canlog.tables.inputs import LogSet, Origins
from canlog.tables.layouts import LongLayout, Values, WideLayout
from canlog.tables.long_rows import LongRows
from canlog.tables.names import TableNames, table_names
from canlog.tables.outputs import TableFormat, check_libraries
from canlog.tables.selection import EVERYTHING, Span, chosen_places
from canlog.tables.sinks import ColumnRows, MessageRows, TableSink
from canlog.tables.table_folder import TableFolder, message_files, table_folder

MAX_CELLS: Final = 8_000_000  # of a row group: 64 MB of numbers
CELLS_PER_VALUE: Final = 8  # of the long table
GROUP_FRAMES: Final = 1_048_576  # of a row group, at most
GROUP_VALUES: Final = 4_718_592  # likewise


class TableShape(StrEnum):
    """What a row of a table is."""

    WIDE = "wide"  # a frame
    LONG = "long"  # a value
    MESSAGES = "messages"  # a frame; each message has a table of its own


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What is decoded, and how it is written."""

    codec: Codec
    names: TableNames
    shape: TableShape = TableShape.WIDE
    values: Values = Values.NUMBERS
    max_cells: int = MAX_CELLS  # of a row group
    max_frames: int = GROUP_FRAMES  # likewise
    max_values: int = GROUP_VALUES  # likewise
    span: Span = EVERYTHING
    is_measured: bool = False  # whether codes that say "not available" are no values
    pairs: tuple[tuple[int, int], ...] = ()  # identifiers of requests and answers, as of ``LongRows``

    @classmethod
    def of(
        cls,
        messages: Sequence[Message],
        shape: TableShape = TableShape.WIDE,
        values: Values = Values.NUMBERS,
    ) -> "Plan":
        codec = Codec(messages, has_long=True)
        return cls(codec=codec, names=table_names(codec.tables), shape=shape, values=values)

    def measured(self) -> "Plan":
        """Return the plan for the same messages in which codes that say "not available" are no values."""
        messages = [table.message for table in self.codec.tables]
        codec = Codec(messages, check_range=False, check_codes=True, has_long=True)
        return replace(self, codec=codec, is_measured=True)

    def part(self, signals: Sequence[str], begin: str | float | None, end: str | float | None) -> "Plan":
        """Return the plan for some signals, all if none is named, and for the stretch between two times.

        Raises
        ------
        DefinitionError
            If a pattern names no signal.
        SourceError
            If a text is no time.
        """
        span, signals = Span.of(begin, end), [signals] if isinstance(signals, str) else signals
        if not signals:
            return replace(self, span=span)
        return replace(self, span=span, codec=self.codec.only(chosen_places(self.names.columns, signals)))

    def layout(
        self, batches: Callable[[], Iterable[FrameBatch]], origins: Origins | None = None
    ) -> WideLayout | LongLayout:
        """Return the columns; for wide rows all frames are looked at, for the messages that occur are the columns."""
        if self.shape is TableShape.LONG:
            return LongLayout(self.codec.tables, self.names, self.values, origins, is_measured=self.is_measured)
        seen: set[int] = set()
        together = LongRows(self.codec, self.pairs)
        for stretch in together.stretches(batches()):
            counts = stretch.match.counts[:-1, list(HAS_VALUES)]
            seen.update(np.flatnonzero(counts.sum(axis=1)).tolist())
        seen.update(together.counts_of)
        slots = sorted(seen)
        return WideLayout(self.codec.tables, self.names, self.values, slots, origins, is_measured=self.is_measured)

    def size(self, layout: WideLayout | LongLayout | None = None, *, is_live: bool = False) -> GroupSize:
        """Return how much a group of rows holds whose columns are all in memory.

        ``layout`` are these columns; None: of one message only.
        """
        most = self.max_cells
        if isinstance(layout, WideLayout):
            frames = max(1, min(self.max_frames, most // len(layout.kinds)))
            return GroupSize(frames=frames, values=self.max_values, is_live=is_live)
        values = max(1, most // CELLS_PER_VALUE) if layout else most
        return GroupSize(frames=self.max_frames, values=values, is_live=is_live)


@dataclass(frozen=True, slots=True, kw_only=True)
class Decoded:
    """What became of some logs."""

    account: DecodeAccount
    readers: tuple[LogReader, ...]  # in the order in which the logs were named; closed
    is_whole: bool  # False: it was stopped
    tables: Mapping[str, str] = field(default_factory=dict)  # of messages: the name of each one's file


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
    check_libraries(table_format, paths)
    is_read_twice = _is_read_twice(plan, table_format)
    with LogSet(paths, is_stopped, is_read_twice=is_read_twice, watch=watch, columns=columns) as logs:
        return _Writing(logs, plan, table_format, is_stopped).write(output)


def _is_read_twice(plan: Plan, table_format: TableFormat) -> bool:
    """Return whether the columns depend on all of the frames."""
    return table_format is not TableFormat.MF4 and plan.shape is TableShape.WIDE


@dataclass(frozen=True, slots=True)
class _Writing:
    """Logs on their way into tables."""

    logs: LogSet
    plan: Plan
    table_format: TableFormat
    is_stopped: Callable[[], bool]

    def write(self, output: Path | BinaryIO) -> Decoded:
        if not isinstance(output, Path):
            return self._into(output)
        if self.plan.shape is TableShape.MESSAGES:
            with table_folder(output, message_files(self.plan.names, self.table_format)) as tables:
                decoded = self._into(tables)
                if decoded.is_whole:
                    return replace(decoded, tables=tables.complete(self.plan.names))
            return decoded
        with replacing(output, OutputError) as part:
            with part.open("wb+") as stream:
                decoded = self._into(stream)
            if decoded.is_whole:
                part.replace(output)
        return decoded

    def _into(self, output: BinaryIO | TableFolder) -> Decoded:
        logs, account = self.logs, DecodeAccount(codec=self.plan.codec, names=self.plan.names)
        sink, size = self._sink(output, account)
        found = stretches(self._frames(account.leave_out), account, self.plan.pairs)
        is_whole = False
        try:
            for group in groups(found, self.plan.codec, size, logs.origins):
                sink.write_group(group)
            if is_whole := not self.is_stopped():
                sink.close()
        finally:
            if not is_whole:
                sink.discard()
        account.log = logs.counts
        account.leave_out(max(0, account.log.frames - sum(account.fates.values())))  # behind the end that was asked for
        return Decoded(account=account, readers=tuple(logs.readers), is_whole=is_whole)

    def _sink(self, output: BinaryIO | TableFolder, account: DecodeAccount) -> tuple[TableSink, GroupSize]:
        """Return what takes the frames, and how many at a time."""
        plan, origins = self.plan, self.logs.origins
        if isinstance(output, TableFolder):
            return MessageRows(output, self.table_format, account, plan.values, origins), plan.size()
        if self.table_format is TableFormat.MF4:
            from canlog.tables.mf4_table import Mf4Table  # noqa: PLC0415 - for this format alone

            return Mf4Table(output, account, origins), plan.size()
        layout = plan.layout(lambda: self._frames(_uncounted), origins)
        is_live = STANDARD_INPUT in self.logs.paths
        return ColumnRows(output, self.table_format, layout, account), plan.size(layout, is_live=is_live)

    def _frames(self, left_out: Callable[[int], None]) -> Iterator[FrameBatch]:
        return self.plan.span.part(_until(self.is_stopped, self.logs.frames()), left_out)


def _uncounted(_: int) -> None:
    """Count nothing: another pass does."""


def _until(is_stopped: Callable[[], bool], batches: Iterable[FrameBatch]) -> Iterator[FrameBatch]:
    for batch in batches:
        if is_stopped():
            return
        yield batch
