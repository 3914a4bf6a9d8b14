"""A log, and its signals as arrays and tables: batch by batch, or all of it in memory."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from cantools.database.can import Database

from canlog.arrays import FloatArray, Int64Array
from canlog.column_files import TIME_TYPE, arrow_schema, load_pyarrow
from canlog.database.loading import database_of
from canlog.extras import load_extra
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, FrameBatch, join
from canlog.logs import LogCounts, LogFormat, LogReader, merged_by_time, read_log
from canlog.tables.account import DecodeAccount, losses
from canlog.tables.decoding import Plan, TableShape, columns_of, message_columns
from canlog.tables.frame_groups import log_paths
from canlog.tables.layouts import BARE_ID, TableShapeName, Values, ValuesName, WideLayout, column_of

KINDS = {
    "time": TIME_TYPE,
    "channel": "uint8",
    "id": "uint32",
    **dict.fromkeys(("is_extended", "is_remote", "is_error", "is_fd"), "bool"),
    "data": "binary",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Samples:
    """One signal, in the order of its frames."""

    t_ns: Int64Array  # (n,) since the epoch
    value: FloatArray  # (n,)
    unit: str  # as the database names it; empty if it does not


class Log:
    """A log, or several together, and what they say; made by ``canlog.read``.

    What it is asked for is read when it is asked: ``batches`` and the tables read the files and keep no frames,
    ``frames`` and what needs all of them keep them. ``pyarrow.table(log)``, ``polars.DataFrame(log)`` and whatever else
    takes a stream of Arrow get the wide table.

    Attributes
    ----------
    paths : tuple of Path
        The files; ``path`` is the first.
    format : LogFormat
        What it was taken for, by its contents.
    """

    def __init__(self, paths: Sequence[Path], database: Database, *, is_strict: bool, columns: str) -> None:
        self.paths = tuple(paths)
        self.path = self.paths[0]
        self._is_strict = is_strict
        self._columns = columns
        self._plan = Plan.of(database.messages)
        with ExitStack() as stack:
            self.format: LogFormat = self._opened(stack)[0].format
        if is_strict:
            _ = self._whole

    @cached_property
    def _whole(self) -> tuple[FrameBatch, LogCounts]:
        with ExitStack() as stack:
            readers = self._opened(stack)
            frames = join(list(merged_by_time(readers)))
            counts = LogCounts()
            for reader in readers:
                counts.add(reader.counts)
        return frames, counts

    @property
    def frames(self) -> FrameBatch:
        """All frames as arrays, in the order of the file; of several files in the order of time."""
        return self._whole[0]

    @property
    def counts(self) -> LogCounts:
        """What the files held besides: lines that are no frames, jumps of time, a missing end."""
        return self._whole[1]

    def __len__(self) -> int:
        return len(self.frames)

    def __repr__(self) -> str:
        count = f", {len(self)} frames" if "_whole" in vars(self) else ""  # nothing is read for a name
        return f"<canlog.Log {', '.join(map(str, self.paths))}: {self.format}{count}>"

    @cached_property
    def account(self) -> DecodeAccount:
        """What became of every frame and every signal when they were decoded."""
        account = self._new_account()
        for batch in self._grouped():
            account.decode(batch)
        return account

    @property
    def losses(self) -> list[str]:
        """What of the log is not among the signals though it should be, in words; empty if nothing is missing."""
        return list(losses(self.account))

    def signals(self, *, is_raw: bool = False) -> dict[str, Samples]:
        """Return the signals that occur, by the names that columns of tables have: ``Message.Signal``.

        Values are as cantools decodes them, whatever the database says of their range, and NaN where the code says
        that there is no value, unless ``is_raw``. A signal has the frames that carry it and no others.
        """
        plan = self._plan_of(is_raw=is_raw)
        rows: dict[tuple[int, str], list[Int64Array]] = {}
        values: dict[tuple[int, str], list[FloatArray]] = {}
        times: list[Int64Array] = []
        start, account = 0, self._new_account(plan)
        for batch in self._grouped():
            for message in account.decode(batch):
                for name, decoded in message.signals.items():
                    present = slice(None) if decoded.is_present is None else decoded.is_present
                    rows.setdefault((message.slot, name), []).append(message.rows[present] + start)
                    value = decoded.value
                    if plan.is_measured and decoded.is_good is not None:
                        value = np.where(decoded.is_good, value, np.nan)
                    values.setdefault((message.slot, name), []).append(value[present])
            times.append(batch.t_ns)
            start += len(batch)
        t_ns = np.concatenate(times) if times else np.empty(0, np.int64)
        signals: dict[str, Samples] = {}
        for (slot, name), column in self._plan.names.columns.items():
            row = np.concatenate(rows.get((slot, name), [np.empty(0, np.int64)]))
            if not len(row):
                continue  # its message, or its page of a multiplexer, did not come
            order = np.argsort(row, kind="stable")  # short frames come apart from the others of their message
            signals[column] = Samples(
                t_ns=t_ns[row[order]],
                value=np.concatenate(values[slot, name])[order],
                unit=self._plan.codec.tables[slot].definitions[name].unit or "",
            )
        return signals

    def to_arrow(
        self, shape: TableShapeName = "messages", values: ValuesName = "numbers", *, is_raw: bool = False
    ) -> Any:  # noqa: ANN401 - untyped
        """Return the signals as tables of pyarrow by message, or as one table.

        Parameters
        ----------
        shape
            ``messages`` for a table of each message that occurs, by its name, with a row per frame; ``wide`` for one
            table with a row per frame and a column per signal: most of its cells are empty, and take memory.
        values
            What stands for a value that the database names: its number, its name, or both in two columns.
        is_raw
            Whether codes that say that there is no value are numbers; else they are null, as in pandas NaN.

        Raises
        ------
        ExtraMissingError
            If pyarrow is not installed.
        """
        if TableShape(shape) is TableShape.MESSAGES:
            return self._message_tables(Values(values), self._plan_of(is_raw=is_raw))
        reader = self.batches(values, is_raw=is_raw)
        return reader.read_all().unify_dictionaries()

    def _message_tables(self, values: Values, plan: Plan) -> dict[str, Any]:
        arrow, account = load_pyarrow(), DecodeAccount(codec=plan.codec, names=plan.names)
        layouts: dict[int, WideLayout] = {}
        batches: dict[int, list[Any]] = {}
        for batch in plan.grouped(self._streamed()):
            for slot, columns in message_columns(batch, account, layouts, values, is_measured=plan.is_measured):
                schema = arrow_schema(layouts[slot].kinds, layouts[slot].metadata)
                batches.setdefault(slot, []).append(arrow.record_batch(list(columns.values()), schema=schema))
        return {
            plan.names.messages[slot]: arrow.Table.from_batches(batches[slot]).unify_dictionaries()
            for slot in sorted(batches)
        }

    def frames_to_arrow(self) -> Any:  # noqa: ANN401 - untyped
        """Return the frames themselves as a table of pyarrow, a row for each; no database is needed.

        Columns are ``time``, ``channel``, ``id``, ``is_extended``, ``is_remote``, ``is_error``, ``is_fd`` and ``data``.
        """
        arrow, frames = load_pyarrow(), self.frames
        ends = np.concatenate(([0], np.cumsum(frames.length, dtype=np.int64)))
        sent = frames.data[np.arange(frames.width) < frames.length[:, np.newaxis]]
        data = arrow.LargeBinaryArray.from_buffers(
            arrow.large_binary(), len(frames), [None, arrow.py_buffer(ends), arrow.py_buffer(sent)]
        )
        flags = [(frames.can_id & np.uint32(flag)) != 0 for flag in (EXTENDED_FLAG, REMOTE_FLAG, ERROR_FLAG)]
        columns = [
            column_of(frames.t_ns, kind=arrow.timestamp("ns", "UTC")),
            column_of(frames.channel),
            column_of(frames.can_id & np.uint32(BARE_ID)),
            *map(column_of, flags),
            column_of((frames.flags & FD_FLAG) != 0),
            data.cast(arrow.binary()),
        ]
        return arrow.table(columns, schema=arrow_schema(KINDS))

    def batches(
        self,
        values: ValuesName = "numbers",
        *,
        signals: Sequence[str] | str = (),
        begin: str | float | None = None,
        end: str | float | None = None,
        is_raw: bool = False,
    ) -> Any:  # noqa: ANN401 - untyped
        """Return a ``pyarrow.RecordBatchReader`` of the wide table, which reads the files as it is read.

        It takes no more memory than a batch, however long the log is. The files are read twice, for the messages that
        occur are the columns. ``signals``, ``begin`` and ``end`` are those of ``write_table``.

        Raises
        ------
        ExtraMissingError
            If pyarrow is not installed.
        """
        arrow = load_pyarrow()
        whole = replace(self._plan_of(is_raw=is_raw), values=Values(values))
        plan = whole.part(signals, begin, end)
        account = DecodeAccount(codec=plan.codec, names=plan.names)
        layout = plan.layout(plan.span.part(self._streamed(), account.leave_out))
        schema = arrow_schema(layout.kinds, layout.metadata)
        frames = plan.span.part(self._streamed(), account.leave_out)
        tables = (columns_of(batch, account, layout) for batch in plan.grouped(frames, layout))
        rows = (arrow.record_batch(list(columns.values()), schema=schema) for columns in tables if columns)
        return arrow.RecordBatchReader.from_batches(schema, rows)

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """Return the wide table as a stream that any library of Arrow takes."""
        return self.batches().__arrow_c_stream__(requested_schema)

    def to_pandas(
        self, shape: TableShapeName = "messages", values: ValuesName = "numbers", *, is_raw: bool = False
    ) -> Any:  # noqa: ANN401 - optional
        """Return what ``to_arrow`` does as DataFrames of pandas; ExtraMissingError if that is not installed."""
        load_extra("pandas", "to_pandas() needs pandas")
        return _converted(self.to_arrow(shape, values, is_raw=is_raw), lambda table: table.to_pandas())

    def to_polars(
        self, shape: TableShapeName = "messages", values: ValuesName = "numbers", *, is_raw: bool = False
    ) -> Any:  # noqa: ANN401 - optional
        """Return what ``to_arrow`` does as DataFrames of polars; ExtraMissingError if that is not installed."""
        polars = load_extra("polars", "to_polars() needs polars")
        return _converted(self.to_arrow(shape, values, is_raw=is_raw), polars.from_arrow)

    def _opened(self, stack: ExitStack) -> list[LogReader]:
        opened = (read_log(path, is_strict=self._is_strict, columns=self._columns) for path in self.paths)
        return [stack.enter_context(closing(reader)) for reader in opened]

    def _streamed(self) -> Iterator[FrameBatch]:
        """Yield all frames: those that are kept, or from the files."""
        if "_whole" in vars(self):
            yield self.frames
            return
        with ExitStack() as stack:
            yield from merged_by_time(self._opened(stack))

    def _plan_of(self, *, is_raw: bool) -> Plan:
        return self._plan if is_raw else self._measured_plan

    @cached_property
    def _measured_plan(self) -> Plan:
        return self._plan.measured()

    def _new_account(self, plan: Plan | None = None) -> DecodeAccount:
        plan = plan or self._plan
        return DecodeAccount(codec=plan.codec, names=plan.names, log=self.counts)

    def _grouped(self) -> Iterator[FrameBatch]:
        return self._plan.grouped([self.frames])


def _converted(tables: Any, convert: Callable[[Any], Any]) -> Any:  # noqa: ANN401 - untyped
    return {name: convert(table) for name, table in tables.items()} if isinstance(tables, dict) else convert(tables)


def read(
    path: Path | str | Sequence[Path | str],
    database: Database | Path | str | None = None,
    *,
    is_strict: bool = False,
    columns: str = "",
) -> Log:
    """Open a log, for its signals as arrays or tables; it is read when it is asked for something.

    A log that is too large for the memory goes batch by batch through ``Log.batches``, or through ``write_table``.

    Parameters
    ----------
    path
        A log of any format that ``canlog.LogFormat`` lists, perhaps compressed; its contents say which. Or several:
        their frames are put in the order of time.
    database
        A DBC, KCD, ARXML or SYM file, ``FILE#BUS`` for one bus of several, or what ``load_database`` made of one;
        without one there are frames and no signals.
    is_strict
        Whether the first line or object that is no frame is an error; else it is counted.
    columns
        Which column of a text is which, ``time=Time,id=ID,data=D1-D8``; by default its header says.

    Raises
    ------
    SourceError
        If the log cannot be opened; when it is read, also if it holds no frame or is damaged.
    DefinitionError
        If the database cannot be used.
    """
    known = Database() if database is None else database_of(database)
    return Log(log_paths(path), known, is_strict=is_strict, columns=columns)
