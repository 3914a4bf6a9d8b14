"""Files of columns by pyarrow, an optional dependency: Parquet, CSV, JSON lines, streams of Arrow; group by group."""

import json
import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from enum import StrEnum
from importlib import import_module
from typing import Any, BinaryIO, Final, Self

from canlog.extras import load_extra

TIME_TYPE = "timestamp[ns, UTC]"
BOOL_TYPE = "bool"
FLOAT_TYPE = "float64"
TIME_ENCODING = "DELTA_BINARY_PACKED"
NAME_TYPE = "name"  # a text of few different values


def load_pyarrow() -> Any:  # noqa: ANN401 - an untyped library
    """Return pyarrow; raises ExtraMissingError if it is not installed."""
    load_extra("pyarrow.parquet", "tables need pyarrow", "parquet")
    return import_module("pyarrow")


def arrow_schema(columns: Mapping[str, str], metadata: Mapping[str, Mapping[str, str]] | None = None) -> Any:  # noqa: ANN401 - an untyped library
    """Return names, types and metadata of columns, as of ``ParquetTable``, for pyarrow."""
    arrow = load_pyarrow()
    special = {TIME_TYPE: arrow.timestamp("ns", "UTC"), NAME_TYPE: arrow.dictionary(arrow.int32(), arrow.string())}
    types = {name: special.get(kind, kind) for name, kind in columns.items()}
    return arrow.schema([arrow.field(name, kind, metadata=(metadata or {}).get(name)) for name, kind in types.items()])


def row_table(rows: Sequence[Mapping[str, object]], schema: Any) -> Any:  # noqa: ANN401 - an untyped library
    """Return rows as a table of pyarrow with a schema of ``arrow_schema``; keys that are missing are null.

    Times may be texts of ISO 8601.
    """
    arrow = load_pyarrow()
    moments = [field.name for field in schema if arrow.types.is_timestamp(field.type)]
    typed = [{**row, **{name: _moment(row.get(name)) for name in moments}} for row in rows]
    return arrow.Table.from_pylist(typed, schema=schema)


def _moment(value: object) -> object:
    return datetime.fromisoformat(value) if isinstance(value, str) else value


class ColumnSink:
    """A file of columns that grows by groups of rows, as one of pyarrow's writers writes them."""

    def __init__(self, writer: Any, schema: Any) -> None:  # noqa: ANN401 - of an untyped library
        self._writer = writer
        self.schema: Any = schema

    def write_columns(self, columns: Mapping[str, Any]) -> None:
        """Write arrays of one length, one per column in their order, as one group."""
        self._writer.write_batch(load_pyarrow().record_batch(list(columns.values()), schema=self.schema))

    def close(self) -> None:
        """Write what the format needs at its end."""
        self._writer.close()

    def discard(self) -> None:
        """Close it though it is not complete: pyarrow would else do so when nothing may be written any more."""
        self.close()


class ParquetTable(ColumnSink):
    """A Parquet file that grows by row groups.

    Parameters
    ----------
    output : binary stream
        It stays open, and its errors are its own.
    columns : Mapping of str to str
        Names and types: ``int32``, ``int64``, ``string``, or one of those above.
    metadata : Mapping of str to Mapping of str to str
        Of columns, such as ``{"unit": "rpm"}``.

    Raises
    ------
    ExtraMissingError
        If pyarrow is not installed.
    """

    def __init__(
        self, output: BinaryIO, columns: Mapping[str, str], metadata: Mapping[str, Mapping[str, str]] | None = None
    ) -> None:
        schema = arrow_schema(columns, metadata)
        writer = load_pyarrow().parquet.ParquetWriter(
            output,
            schema,
            compression="zstd",
            # zstd packs floats better and sooner than a dictionary; times hardly repeat, so differences are smaller.
            # Minima of names and booleans serve no query.
            use_dictionary=[name for name, kind in columns.items() if kind not in {TIME_TYPE, FLOAT_TYPE}],
            write_statistics=[name for name, kind in columns.items() if kind not in {NAME_TYPE, BOOL_TYPE}],
            column_encoding={name: TIME_ENCODING for name, kind in columns.items() if kind == TIME_TYPE},
        )
        super().__init__(writer, schema)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write_rows(self, rows: Sequence[Mapping[str, object]]) -> None:
        """Write rows as one group; keys that are missing are null."""
        if rows:
            self._writer.write_table(row_table(rows, self.schema))


class TableFormat(StrEnum):
    PARQUET = "parquet"
    CSV = "csv"
    JSON_LINES = "jsonl"
    ARROW = "arrow"  # a stream of record batches, not a file that can be sought in


FORMAT_OF_SUFFIX: Final[Mapping[str, TableFormat]] = {
    ".parquet": TableFormat.PARQUET,
    ".csv": TableFormat.CSV,
    ".jsonl": TableFormat.JSON_LINES,
    ".arrows": TableFormat.ARROW,
}
SUFFIX_OF_FORMAT: Final[Mapping[TableFormat, str]] = {
    table_format: suffix for suffix, table_format in FORMAT_OF_SUFFIX.items()
}
STREAMED: Final = frozenset({TableFormat.CSV, TableFormat.JSON_LINES, TableFormat.ARROW})
ARROW_COMPRESSION: Final = "lz4"  # most cells of a wide table are empty: writing takes longer than packing
_TEXT: Final = "string"


def open_columns(
    output: BinaryIO, table_format: TableFormat, kinds: Mapping[str, str], metadata: Mapping[str, Mapping[str, str]]
) -> ColumnSink:
    """Begin a table of columns, named with their types as of ``ParquetTable``.

    Raises ExtraMissingError if pyarrow is not installed.
    """
    match table_format:
        case TableFormat.PARQUET:
            return ParquetTable(output, kinds, metadata)
        case TableFormat.CSV:
            return _Csv(output, kinds)
        case TableFormat.JSON_LINES:
            return _JsonLines(output, kinds)
        case _:
            return _ArrowStream(output, kinds, metadata)


class _ArrowStream(ColumnSink):
    """What ``pyarrow.ipc.open_stream`` reads."""

    def __init__(self, output: BinaryIO, kinds: Mapping[str, str], metadata: Mapping[str, Mapping[str, str]]) -> None:
        ipc, schema, self._output = load_pyarrow().ipc, arrow_schema(kinds, metadata), output
        options = ipc.IpcWriteOptions(compression=ARROW_COMPRESSION)
        super().__init__(ipc.new_stream(output, schema, options=options), schema)

    def write_columns(self, columns: Mapping[str, Any]) -> None:
        super().write_columns(columns)
        self._output.flush()

    def discard(self) -> None:
        """Write no end, so that a reader notices."""


class _Csv(ColumnSink):
    """A line of names, then a line per row; times as ISO 8601, an empty cell for what is not there."""

    def __init__(self, output: BinaryIO, kinds: Mapping[str, str]) -> None:
        load_pyarrow()
        from pyarrow import csv  # noqa: PLC0415 - optional

        self._output, self._kinds = output, kinds
        schema = arrow_schema({name: _TEXT if kind in {TIME_TYPE, NAME_TYPE} else kind for name, kind in kinds.items()})
        super().__init__(csv.CSVWriter(output, schema, write_options=csv.WriteOptions(quoting_style="needed")), schema)

    def write_columns(self, columns: Mapping[str, Any]) -> None:
        super().write_columns({name: _as_text(column, self._kinds[name]) for name, column in columns.items()})
        self._output.flush()


class _JsonLines(ColumnSink):
    """An object per row, without what is not there; a number that is none is null."""

    def __init__(self, output: BinaryIO, kinds: Mapping[str, str]) -> None:
        super().__init__(None, None)  # pyarrow reads such files, but writes none
        load_pyarrow()
        self._output, self._kinds = output, kinds

    def write_columns(self, columns: Mapping[str, Any]) -> None:
        rows: list[dict[str, object]] = []
        for name, column in columns.items():
            where, values = _present(_as_text(column, self._kinds[name]))
            if not rows:
                rows = [{} for _ in values]  # the first column, the time, has a value in every row
            for row, value in zip(where, values, strict=True):
                rows[row][name] = None if isinstance(value, float) and not math.isfinite(value) else value
        text = "".join(json.dumps(row, separators=(",", ":"), allow_nan=False) + "\n" for row in rows)
        self._output.write(text.encode())
        self._output.flush()

    def close(self) -> None:
        """Nothing: the format has no end."""


def _as_text(column: Any, kind: str) -> Any:  # noqa: ANN401 - arrays of pyarrow or numpy
    """Return a column with times and names as texts."""
    arrow = load_pyarrow()
    if kind == NAME_TYPE:
        return column.dictionary_decode()
    if kind == TIME_TYPE:
        from pyarrow import compute  # noqa: PLC0415 - optional

        # Without its zone: the texts of zones need a database that a system may lack.
        texts = compute.replace_substring(column.cast(arrow.timestamp("ns")).cast(arrow.string()), " ", "T")
        return compute.binary_join_element_wise(texts, "Z", "")
    return column


def _present(column: Any) -> tuple[list[int], list[object]]:  # noqa: ANN401 - an array of pyarrow or numpy
    """Return the rows in which a column has a value, and the values."""
    array = load_pyarrow().array(column)
    if not array.null_count:
        return list(range(len(array))), array.to_pylist()
    where = array.is_valid().to_numpy(zero_copy_only=False).nonzero()[0].tolist()
    return where, array.drop_null().to_pylist()
