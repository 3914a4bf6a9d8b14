"""Logs to tables: one pass from frames to columns and the account of what is not in them, for files and for memory."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from difflib import get_close_matches
from enum import StrEnum
from fnmatch import fnmatchcase
from itertools import groupby
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal

import numpy as np
from cantools.database.can import Database, Message

from canlog.column_files import FORMAT_OF_SUFFIX, ColumnSink, TableFormat, load_pyarrow, open_columns
from canlog.database.loading import database_of
from canlog.decode.codec import HAS_VALUES, Codec
from canlog.errors import DefinitionError, OutputError, SourceError
from canlog.files import is_folder, replacing
from canlog.frames import FrameBatch
from canlog.logs import STANDARD_INPUT, LogReader
from canlog.logs.reading import Watch
from canlog.logs.streams import never
from canlog.tables.account import DecodeAccount, losses
from canlog.tables.frame_groups import LogSet, grouped, log_paths
from canlog.tables.layouts import (
    Place,
    TableNames,
    TableShapeName,
    Values,
    ValuesName,
    WideLayout,
    frame_kinds,
    table_names,
)
from canlog.tables.table_folder import TableFolder, message_files, table_folder

JUMP_NS: Final = 60_000_000_000  # so far behind the end a log is read on: its clock may jump back
_NS_PER_S: Final = 1_000_000_000
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_LEAST, _MOST = -(2**63), 2**63 - 1


def chosen_places(columns: Mapping[Place, str], patterns: Sequence[str]) -> frozenset[Place]:
    """Return the signals that patterns name: ``Message.Signal``, a signal alone, or with ``*``, ``?`` and ``[...]``.

    Raises DefinitionError if a pattern names none.
    """
    chosen: set[Place] = set()
    for pattern in patterns:
        places = {place for place, column in columns.items() if fnmatchcase(column, pattern) or place[1] == pattern}
        places |= {place for place in columns if "." not in pattern and fnmatchcase(place[1], pattern)}
        if not places:
            names = [*columns.values(), *(name for _, name in columns)]
            near = ", ".join(dict.fromkeys(get_close_matches(pattern, names)))
            raise DefinitionError(f"no signal is called {pattern}" + (f"; there is {near}" if near else ""))
        chosen |= places
    return frozenset(chosen)


@dataclass(frozen=True, slots=True)
class TimeLimit:
    """A time, or so many seconds behind the first frame."""

    ns: int
    is_elapsed: bool

    @classmethod
    def of(cls, text: str) -> "TimeLimit":
        """Return the moment that a text names: ``12.5`` seconds, or ISO 8601, in UTC unless it says otherwise.

        Raises SourceError if it names none.
        """
        try:
            return cls(round(float(text) * _NS_PER_S), is_elapsed=True)
        except (ValueError, OverflowError):
            pass
        try:
            moment = datetime.fromisoformat(text)
        except ValueError:
            raise SourceError(
                f"{text!r} is not a time: 12.5 (seconds from the first frame) or 2026-01-01T12:30:00"
            ) from None
        moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
        return cls((moment - _EPOCH) // timedelta(microseconds=1) * 1_000, is_elapsed=False)

    def at_ns(self, first_ns: int) -> int:
        """Return when that is in a log with its first frame at ``first_ns``."""
        return self.ns + first_ns if self.is_elapsed else self.ns


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of a log: from its begin on, up to its end and without it; None: all that there is."""

    begin: TimeLimit | None = None
    end: TimeLimit | None = None

    @classmethod
    def of(cls, begin: str | float | None, end: str | float | None) -> "Span":
        """Return the stretch between two moments, or without a limit; raises SourceError if it can be none."""
        first, last = (None if limit is None else TimeLimit.of(str(limit)) for limit in (begin, end))
        if first and last and first.is_elapsed is last.is_elapsed and first.ns >= last.ns:
            raise SourceError(f"nothing lies between {begin} and {end}: the first time must be before the second")
        return cls(first, last)

    def part(self, batches: Iterable[FrameBatch], left_out: Callable[[int], object]) -> Iterator[FrameBatch]:
        """Yield what of some batches lies inside; ``left_out`` is called with how many frames do not.

        Reading ends with the first batch that lies far behind the end.
        """
        if self.begin is None and self.end is None:
            yield from batches
            return
        begin_ns = end_ns = None
        for batch in batches:
            if begin_ns is None and len(batch):
                first_ns = int(batch.t_ns[0])
                begin_ns = _LEAST if self.begin is None else self.begin.at_ns(first_ns)
                end_ns = _MOST if self.end is None else self.end.at_ns(first_ns)
            if begin_ns is None or end_ns is None:
                continue
            is_inside = (batch.t_ns >= begin_ns) & (batch.t_ns < end_ns)
            inside = batch if is_inside.all() else batch[is_inside]
            left_out(len(batch) - len(inside))
            if len(inside):
                yield inside
            elif int(np.min(batch.t_ns)) - JUMP_NS >= end_ns:
                return


EVERYTHING: Final = Span()


def columns_of(batch: FrameBatch, account: DecodeAccount, layout: WideLayout) -> Mapping[str, Any]:
    """Return the columns of some frames, empty if they have no rows; frames, values and rows enter the account."""
    messages = account.decode(batch)
    count, columns = layout.columns(batch, messages) if messages else (0, {})
    account.row_count += count
    return columns if count else {}


class ColumnRows:
    """Writes groups of frames into one wide table."""

    def __init__(self, output: BinaryIO, table_format: TableFormat, layout: WideLayout, account: DecodeAccount) -> None:
        self._layout = layout
        self._account = account
        self._columns = open_columns(output, table_format, layout.kinds, layout.metadata)

    def write(self, batch: FrameBatch) -> None:
        """Write some frames; they, their values and rows enter the account."""
        if columns := columns_of(batch, self._account, self._layout):
            self._columns.write_columns(columns)

    def close(self) -> None:
        self._columns.close()

    def discard(self) -> None:
        self._columns.discard()


def message_columns(
    batch: FrameBatch,
    account: DecodeAccount,
    layouts: dict[int, WideLayout],
    values: Values,
    logs: Sequence[str] = (),
    *,
    is_measured: bool = False,
) -> Iterator[tuple[int, Mapping[str, Any]]]:
    """Yield the columns of each message in a group, called as its signals are; all enters the account.

    ``layouts`` are those of the messages that came until now, by slot.
    """
    for slot, parts in groupby(account.decode(batch), key=lambda message: message.slot):
        if slot not in layouts:
            names = account.names.of_message(slot, frame_kinds(logs))
            layouts[slot] = WideLayout(account.codec.tables, names, values, [slot], logs, is_measured=is_measured)
        count, columns = layouts[slot].columns(batch, list(parts))
        account.row_count += count
        yield slot, columns


@dataclass(slots=True)
class MessageRows:
    """Writes groups of frames into a table for each message, of its frames alone."""

    tables: TableFolder
    table_format: TableFormat
    account: DecodeAccount
    values: Values
    logs: Sequence[str]  # the names of several logs
    _layouts: dict[int, WideLayout] = field(default_factory=dict)
    _open: dict[int, ColumnSink] = field(default_factory=dict)

    def write(self, batch: FrameBatch) -> None:
        for slot, columns in message_columns(batch, self.account, self._layouts, self.values, self.logs):
            if slot not in self._open:
                file, layout = self.tables.file(slot), self._layouts[slot]
                self._open[slot] = open_columns(file, self.table_format, layout.kinds, layout.metadata)
            self._open[slot].write_columns(columns)

    def close(self) -> None:
        for sink in self._open.values():
            sink.close()

    def discard(self) -> None:
        for sink in self._open.values():
            sink.discard()


MAX_CELLS: Final = 8_000_000  # of a row group: 64 MB of numbers
GROUP_FRAMES: Final = 1_048_576  # of a row group, at most
GROUP_VALUES: Final = 4_718_592  # likewise


class TableShape(StrEnum):
    """What a row of a table is."""

    WIDE = "wide"  # a frame
    MESSAGES = "messages"  # a frame; each message has a table of its own


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What is decoded, and how it is written."""

    codec: Codec
    names: TableNames
    shape: TableShape = TableShape.WIDE
    values: Values = Values.NUMBERS
    span: Span = EVERYTHING
    is_measured: bool = False  # whether codes that say "not available" are no values

    @classmethod
    def of(
        cls, messages: Sequence[Message], shape: TableShape = TableShape.WIDE, values: Values = Values.NUMBERS
    ) -> "Plan":
        codec = Codec(messages)
        return cls(codec=codec, names=table_names(codec.tables), shape=shape, values=values)

    def measured(self) -> "Plan":
        """Return the plan for the same messages in which codes that say "not available" are no values."""
        messages = [table.message for table in self.codec.tables]
        codec = Codec(messages, check_range=False, check_codes=True)
        return replace(self, codec=codec, is_measured=True)

    def part(self, signals: Sequence[str], begin: str | float | None, end: str | float | None) -> "Plan":
        """Return the plan for some signals, all if none is named, and for the stretch between two times.

        Raises DefinitionError if a pattern names no signal, SourceError if a text is no time.
        """
        span, signals = Span.of(begin, end), [signals] if isinstance(signals, str) else signals
        if not signals:
            return replace(self, span=span)
        return replace(self, span=span, codec=self.codec.only(chosen_places(self.names.columns, signals)))

    def layout(self, batches: Iterable[FrameBatch], logs: Sequence[str] = ()) -> WideLayout:
        """Return the columns: all frames are looked at, for the messages that occur are the columns."""
        has_values = np.zeros(len(self.codec.tables), np.bool_)
        for batch in batches:
            has_values |= self.codec.match(batch).counts[:-1, list(HAS_VALUES)].any(axis=1)
        slots = np.flatnonzero(has_values).tolist()
        return WideLayout(self.codec.tables, self.names, self.values, slots, logs, is_measured=self.is_measured)

    def grouped(
        self, batches: Iterable[FrameBatch], layout: WideLayout | None = None, *, is_live: bool = False
    ) -> Iterator[FrameBatch]:
        """Yield frames in groups that fit the memory as rows of a layout; None: of one message only."""
        most_values = max((len(table.signals) for table in self.codec.tables), default=1) or 1
        most_cells = most_values if layout is None else len(layout.kinds)
        count = min(GROUP_FRAMES, MAX_CELLS // most_cells, GROUP_VALUES // most_values)
        return grouped(batches, max(1, count), is_live=is_live)


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodedLogs:
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
) -> DecodedLogs:
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
    load_pyarrow()
    is_read_twice = plan.shape is TableShape.WIDE  # columns depend on all frames
    with LogSet(paths, is_stopped, is_read_twice=is_read_twice, watch=watch, columns=columns) as logs:
        return _Writing(logs, plan, table_format, is_stopped).write(output)


@dataclass(frozen=True, slots=True)
class _Writing:
    """Logs on their way into tables."""

    logs: LogSet
    plan: Plan
    table_format: TableFormat
    is_stopped: Callable[[], bool]

    def write(self, output: Path | BinaryIO) -> DecodedLogs:
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

    def _into(self, output: BinaryIO | TableFolder) -> DecodedLogs:
        logs, account = self.logs, DecodeAccount(codec=self.plan.codec, names=self.plan.names)
        sink, batches = self._sink(output, account)
        is_whole = False
        try:
            for batch in batches:
                sink.write(batch)
            if is_whole := not self.is_stopped():
                sink.close()
        finally:
            if not is_whole:
                sink.discard()
        account.log = logs.counts
        account.leave_out(max(0, account.log.frames - sum(account.fates.values())))  # behind the end that was asked for
        return DecodedLogs(account=account, readers=tuple(logs.readers), is_whole=is_whole)

    def _sink(
        self, output: BinaryIO | TableFolder, account: DecodeAccount
    ) -> tuple[ColumnRows | MessageRows, Iterator[FrameBatch]]:
        """Return what takes the frames, and these, in groups."""
        plan, logs = self.plan, self.logs
        if isinstance(output, TableFolder):
            sink = MessageRows(output, self.table_format, account, plan.values, logs.names)
            return sink, plan.grouped(self._frames(account.leave_out))
        layout = plan.layout(self._frames(lambda _: None), logs.names)  # another pass counts
        frames = plan.grouped(self._frames(account.leave_out), layout, is_live=STANDARD_INPUT in logs.paths)
        return ColumnRows(output, self.table_format, layout, account), frames

    def _frames(self, left_out: Callable[[int], object]) -> Iterator[FrameBatch]:
        return self.plan.span.part(_until(self.is_stopped, self.logs.frames()), left_out)


def _until(is_stopped: Callable[[], bool], batches: Iterable[FrameBatch]) -> Iterator[FrameBatch]:
    for batch in batches:
        if is_stopped():
            return
        yield batch


FormatName = Literal["parquet", "csv", "jsonl", "arrow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TableChoice:
    """What of some logs is written as a table, and how.

    Parameters
    ----------
    table_format : {"parquet", "csv", "jsonl", "arrow"}, optional
        By default what the suffix says: ``.parquet``, ``.csv``, ``.jsonl``, ``.arrows``; of a folder Parquet.
    shape, values
        As of ``Log.to_arrow``; ``messages`` is a folder with a table for each message, and the default where the output
        is a folder or has no suffix, ``wide`` that of a file.
    signals
        Only these: ``Message.Signal`` or the signal alone, both with ``*`` for anything; by default all. A text is one.
    begin, end
        Only what lies between: seconds from the first frame, or a time as ISO 8601, in UTC unless it says otherwise.
    columns
        Which column of a text is which, as of ``read``.
    """

    table_format: FormatName | None = None
    shape: TableShapeName | None = None
    values: ValuesName = "numbers"
    signals: Sequence[str] | str = ()
    begin: str | float | None = None
    end: str | float | None = None
    columns: str = ""

    def plan(self, messages: Sequence[Message]) -> Plan:
        """Return what is decoded of the messages of a database; raises as ``Plan.part`` does."""
        whole = Plan.of(messages, TableShape(self.shape or "wide"), Values(self.values))
        return whole.part(self.signals, self.begin, self.end)

    def format_of(self, output: Path) -> TableFormat:
        """Return the format of a file; raises OutputError if there is no such format."""
        if self.shape == "messages" and self.table_format is None:
            return TableFormat.PARQUET
        try:
            return (
                FORMAT_OF_SUFFIX[output.suffix.lower()] if self.table_format is None else TableFormat(self.table_format)
            )
        except (KeyError, ValueError):
            *some, last = TableFormat
            named = f"name it: {', '.join(some)} or {last} (--format; from Python table_format)"
            raise OutputError(f"{output} says no format, as {', '.join(FORMAT_OF_SUFFIX)} do; {named}") from None


EVERY_SIGNAL: Final = TableChoice()


def default_shape(output: Path, *, is_of_folder: bool = False) -> TableShapeName:
    """Return the default shape: a folder has a table for each message, a file is one wide table.

    ``is_of_folder``: whatever the output is called, since each of several logs gets a folder of its own there.
    """
    is_one_table = str(output) == "-" or (output.suffix != "" and not is_folder(output) and not is_of_folder)
    return "wide" if is_one_table else "messages"


def write_table(
    path: Path | str | Sequence[Path | str],
    database: Database | Path | str,
    output: Path | str,
    choice: TableChoice = EVERY_SIGNAL,
) -> list[str]:
    """Write the signals of logs into a table, in bounded memory; return what is missing there, in words.

    Parameters
    ----------
    path, database
        As of ``read``.
    output
        The table, which appears when it is complete; one that is there is replaced. Of ``messages`` the folder of the
        tables: of those that are there, the ones of messages of the database are replaced or removed.
    choice
        What is written, and how: every signal, unless it says otherwise.

    Raises
    ------
    SourceError, DefinitionError, ExtraMissingError
        As ``read`` and ``Log.to_arrow`` do.
    OutputError
        If there is no such format, or the file cannot be written.
    """
    written = Path(output)
    choice = replace(choice, shape=choice.shape or default_shape(written))
    plan = choice.plan(database_of(database).messages)
    decoded = decode_logs(log_paths(path), plan, written, choice.format_of(written), columns=choice.columns)
    return list(losses(decoded.account))
