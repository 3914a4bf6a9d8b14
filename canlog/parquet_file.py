"""Parquet files through pyarrow, an optional dependency; written row group by row group."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from canlog.errors import OutputError
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
    """Return rows as a table of pyarrow with a schema of ``arrow_schema``; keys that are missing are null."""
    return load_pyarrow().Table.from_pylist(list(rows), schema=schema)


class ParquetTable:
    """A Parquet file that grows by row groups.

    Parameters
    ----------
    path : Path
        The file.
    columns : Mapping of str to str
        Names and types: ``int32``, ``int64``, ``float64``, ``string``, ``BOOL_TYPE``, ``TIME_TYPE`` or ``NAME_TYPE``.
    metadata : Mapping of str to Mapping of str to str
        Of columns, such as ``{"unit": "rpm"}``.

    Raises
    ------
    ExtraMissingError
        If pyarrow is not installed.
    OutputError
        If the file cannot be written.
    """

    def __init__(
        self, path: Path, columns: Mapping[str, str], metadata: Mapping[str, Mapping[str, str]] | None = None
    ) -> None:
        self._arrow = load_pyarrow()
        self._path = path
        self.schema: Any = arrow_schema(columns, metadata)
        try:
            self._file = path.open("wb")  # pyarrow itself takes no name that is not UTF-8
            self._writer = self._arrow.parquet.ParquetWriter(
                self._file,
                self.schema,
                compression="zstd",
                # Times hardly repeat, so differences are smaller; nobody looks for the least of some names.
                use_dictionary=[name for name, kind in columns.items() if kind != TIME_TYPE],
                write_statistics=[name for name, kind in columns.items() if kind not in {NAME_TYPE, BOOL_TYPE}],
                column_encoding={name: TIME_ENCODING for name, kind in columns.items() if kind == TIME_TYPE},
            )
        except OSError as exc:
            raise OutputError(f"cannot write {path}: {exc.strerror or exc}") from exc

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._translated(self._writer.close)
        finally:
            self._translated(self._file.close)

    def write_rows(self, rows: Sequence[Mapping[str, object]]) -> None:
        """Write rows as one group; keys that are missing are null."""
        if rows:
            table = row_table(rows, self.schema)
            self._translated(lambda: self._writer.write_table(table))

    def write_columns(self, columns: Mapping[str, object]) -> None:
        """Write arrays of one length, one per column in their order, as one group."""
        batch = self._arrow.record_batch(list(columns.values()), schema=self.schema)
        self._translated(lambda: self._writer.write_batch(batch))

    def _translated(self, write: Any) -> None:  # noqa: ANN401 - a call into an untyped library
        try:
            write()
        except OSError as exc:
            raise OutputError(f"cannot write {self._path}: {exc.strerror or exc}") from exc
