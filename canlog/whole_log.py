"""A log, and its signals as arrays and tables: batch by batch, or all of it in memory."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from cantools.database.can import Database

from canlog.arrays import FloatArray, Int64Array
from canlog.database.loading import database_of
from canlog.extras import load_extra
from canlog.frame_columns import join
from canlog.frames import FrameBatch
from canlog.logs import LogCounts, LogFormat, LogReader, merged_by_time, read_log
from canlog.parquet_file import arrow_schema, load_pyarrow
from canlog.tables.account import DecodeAccount
from canlog.tables.decoding import MAX_CELLS, Plan, TableShape
from canlog.tables.frame_stock import FrameGroup
from canlog.tables.groups import columns_of, groups, stretches, values_in
from canlog.tables.inputs import log_paths
from canlog.tables.layouts import ShapeName, Values, ValuesName
from canlog.tables.report import losses
from canlog.transport import LongMessage, LongMessages


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

    def __init__(
        self,
        paths: Sequence[Path],
        database: Database,
        *,
        is_strict: bool = False,
        max_cells: int = MAX_CELLS,
        columns: str = "",
    ) -> None:
        self.paths = tuple(paths)
        self.path = self.paths[0]
        self._is_strict = is_strict
        self._columns = columns
        self._plan = replace(Plan.of(database.messages), max_cells=max_cells)
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
        return f"<canlog.Log {', '.join(map(str, self.paths))}: {self.format}, {len(self)} frames>"

    @cached_property
    def account(self) -> DecodeAccount:
        """What became of every frame and every signal when they were decoded."""
        account = self._new_account()
        for group in self._groups(account):
            values_in(group, account)
        return account

    @property
    def losses(self) -> list[str]:
        """What of the log is not among the signals though it should be, in words; empty if nothing is missing."""
        return list(losses(self.account))

    def signals(self) -> dict[str, Samples]:
        """Return the signals that occur, by the names that columns of tables have: ``Message.Signal``.

        Values are as cantools decodes them, whatever the database says of their range; a signal has the frames that
        carry it and no others.
        """
        rows: dict[tuple[int, str], list[Int64Array]] = {}
        values: dict[tuple[int, str], list[FloatArray]] = {}
        times: list[Int64Array] = []
        start, account = 0, self._new_account()
        for group in self._groups(account):
            for one in values_in(group, account):
                for name, decoded in one.signals.items():
                    kept = slice(None) if decoded.is_present is None else decoded.is_present
                    rows.setdefault((one.slot, name), []).append(one.rows[kept] + start)
                    values.setdefault((one.slot, name), []).append(decoded.value[kept])
            times.append(group.frames.t_ns)
            start += len(group)
        t_ns = np.concatenate(times) if times else np.empty(0, np.int64)
        signals: dict[str, Samples] = {}
        for (slot, name), column in self._plan.names.columns.items():
            if (slot, name) not in rows:
                continue
            row = np.concatenate(rows[slot, name])
            order = np.argsort(row, kind="stable")  # short frames come apart from the others of their message
            signals[column] = Samples(
                t_ns=t_ns[row[order]],
                value=np.concatenate(values[slot, name])[order],
                unit=self._plan.codec.tables[slot].definitions[name].unit or "",
            )
        return signals

    def long_messages(self) -> list[LongMessage]:
        """Return the messages that are longer than a frame: put together, and decoded if the database has them.

        ISO-TP, J1939 transport and fast packets of NMEA 2000; what is not whole is not among them.
        """
        together = LongMessages([table.message for table in self._plan.codec.tables])
        return [*together.feed(self.frames), *together.close()]

    def to_arrow(self, shape: ShapeName = "wide", values: ValuesName = "numbers") -> Any:  # noqa: ANN401 - untyped
        """Return the signals as a table of pyarrow, the one that ``write_parquet`` writes.

        Parameters
        ----------
        shape
            Of a row: ``wide`` for one a frame with a column for each signal, ``long`` for one a value.
        values
            What stands for a value that the database names: its number, its name, or both in two columns.

        Raises
        ------
        ExtraMissingError
            If pyarrow is not installed.
        """
        reader = self.batches(shape, values)
        return load_pyarrow().Table.from_batches(reader, schema=reader.schema).unify_dictionaries()

    def batches(
        self,
        shape: ShapeName = "wide",
        values: ValuesName = "numbers",
        *,
        signals: Sequence[str] = (),
        begin: str | float | None = None,
        end: str | float | None = None,
    ) -> Any:  # noqa: ANN401 - untyped
        """Return a ``pyarrow.RecordBatchReader`` of the table of ``to_arrow``, which reads the files as it is read.

        It takes no more memory than a batch, however long the log is. For wide rows the files are read twice, for the
        messages that occur are the columns. ``signals``, ``begin`` and ``end`` are those of ``write_table``.

        Raises
        ------
        ExtraMissingError
            If pyarrow is not installed.
        """
        arrow = load_pyarrow()
        whole = replace(self._plan, shape=TableShape(shape), values=Values(values))
        plan = whole.part(signals, begin, end)
        account = DecodeAccount(codec=plan.codec, names=plan.names)
        layout = plan.layout(lambda: plan.span.part(self._streamed(), account.leave_out))
        schema = arrow_schema(layout.kinds, layout.metadata)
        frames = plan.span.part(self._streamed(), account.leave_out)
        found = groups(stretches(frames, account), plan.codec, plan.size(layout))
        tables = (columns_of(group, account, layout) for group in found)
        rows = (arrow.record_batch(list(columns.values()), schema=schema) for columns in tables if columns)
        return arrow.RecordBatchReader.from_batches(schema, rows)

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """Return the wide table as a stream that any library of Arrow takes."""
        return self.batches().__arrow_c_stream__(requested_schema)

    def to_pandas(self, shape: ShapeName = "wide", values: ValuesName = "numbers") -> Any:  # noqa: ANN401 - optional
        """Return the table of ``to_arrow`` as a DataFrame of pandas; ExtraMissingError if that is not installed."""
        load_extra("pandas", "to_pandas() needs pandas")
        return self.to_arrow(shape, values).to_pandas()

    def to_polars(self, shape: ShapeName = "wide", values: ValuesName = "numbers") -> Any:  # noqa: ANN401 - optional
        """Return the table of ``to_arrow`` as a DataFrame of polars; ExtraMissingError if that is not installed."""
        polars = load_extra("polars", "to_polars() needs polars")
        return polars.from_arrow(self.to_arrow(shape, values))

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

    def _new_account(self) -> DecodeAccount:
        return DecodeAccount(codec=self._plan.codec, names=self._plan.names, log=self.counts)

    def _groups(self, account: DecodeAccount) -> Iterator[FrameGroup]:
        return groups(stretches([self.frames], account), self._plan.codec, self._plan.size())


def read(
    path: Path | str | Sequence[Path | str],
    database: Database | Path | str,
    *,
    is_strict: bool = False,
    is_lenient: bool = False,
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
        A DBC, KCD, ARXML or SYM file, ``FILE#BUS`` for one bus of several, or what ``load_database`` made of one.
    is_strict
        Whether the first line or object that is no frame is an error; else it is counted.
    is_lenient
        Whether items of a DBC file that cannot be right are left out, with a warning of each.
    columns
        Which column of a text is which, ``time=Time,id=ID,data=D1-D8``; by default its header says.

    Raises
    ------
    SourceError
        If the log cannot be read; that it holds no frame, or cannot be read on, is told when it is read.
    DefinitionError
        If the database cannot be used.
    """
    return Log(log_paths(path), database_of(database, is_lenient=is_lenient), is_strict=is_strict, columns=columns)
