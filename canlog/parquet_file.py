"""Parquet files through pyarrow, an optional dependency; written row group by row group."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from importlib import import_module
from typing import Any, BinaryIO, Self

from canlog.extras import load_extra

TIME_TYPE = "timestamp[ns, UTC]"
BOOL_TYPE = "bool"
TIME_ENCODING = "DELTA_BINARY_PACKED"
NAME_TYPE = "name"  # a text of few different values


def load_pyarrow() -> Any:  # noqa: ANN401 - an untyped library
    """Return pyarrow.

    Raises
    ------
    ExtraMissingError
        If it is not installed.
    """
    load_extra("pyarrow.parquet", "Parquet needs pyarrow", "parquet")
    return import_module("pyarrow")


def arrow_schema(columns: Mapping[str, str], metadata: Mapping[str, Mapping[str, str]] | None = None) -> Any:  # noqa: ANN401 - an untyped library
    """Return names, types and metadata of columns, as of ``ParquetTable``, for pyarrow."""
    arrow = load_pyarrow()
    own = {TIME_TYPE: arrow.timestamp("ns", "UTC"), NAME_TYPE: arrow.dictionary(arrow.int32(), arrow.string())}
    return arrow.schema(
        [arrow.field(name, own.get(kind, kind), metadata=(metadata or {}).get(name)) for name, kind in columns.items()]
    )


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


class ParquetTable:
    """A Parquet file that grows by row groups.

    Parameters
    ----------
    output : binary stream
        It stays open, and its errors are its own.
    columns : Mapping of str to str
        Names and types: ``int32``, ``int64``, ``float64``, ``string``, ``BOOL_TYPE``, ``TIME_TYPE`` or ``NAME_TYPE``.
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
        self._arrow = load_pyarrow()
        self.schema: Any = arrow_schema(columns, metadata)
        self._writer = self._arrow.parquet.ParquetWriter(
            output,
            self.schema,
            compression="zstd",
            # Times hardly repeat, so differences are smaller; nobody looks for the least of some names.
            use_dictionary=[name for name, kind in columns.items() if kind != TIME_TYPE],
            write_statistics=[name for name, kind in columns.items() if kind not in {NAME_TYPE, BOOL_TYPE}],
            column_encoding={name: TIME_ENCODING for name, kind in columns.items() if kind == TIME_TYPE},
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Write the end of the file."""
        self._writer.close()

    def discard(self) -> None:
        """Close it: pyarrow would else do so when nothing may be written any more."""
        self.close()

    def write_rows(self, rows: Sequence[Mapping[str, object]]) -> None:
        """Write rows as one group; keys that are missing are null."""
        if rows:
            self._writer.write_table(row_table(rows, self.schema))

    def write_columns(self, columns: Mapping[str, object]) -> None:
        """Write arrays of one length, one per column in their order, as one group."""
        self._writer.write_batch(self._arrow.record_batch(list(columns.values()), schema=self.schema))
