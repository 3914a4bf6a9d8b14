"""The formats that tables are written in, and how columns become Parquet, CSV, JSON lines and a stream of Arrow."""

import json
import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from importlib.machinery import PathFinder
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, Final, Protocol

from canlog.extras import extra_missing
from canlog.parquet_file import NAME_TYPE, TIME_TYPE, ParquetTable, arrow_schema, load_pyarrow


class TableFormat(StrEnum):
    """The formats of tables."""

    PARQUET = "parquet"
    CSV = "csv"
    JSON_LINES = "jsonl"
    ARROW = "arrow"  # a stream of record batches, not a file that can be sought in
    MF4 = "mf4"


FORMAT_OF_SUFFIX: Final[Mapping[str, TableFormat]] = MappingProxyType(
    {
        ".parquet": TableFormat.PARQUET,
        ".csv": TableFormat.CSV,
        ".jsonl": TableFormat.JSON_LINES,
        ".arrows": TableFormat.ARROW,
        ".mf4": TableFormat.MF4,
    }
)
SUFFIX_OF_FORMAT: Final[Mapping[TableFormat, str]] = MappingProxyType(
    {table_format: suffix for suffix, table_format in FORMAT_OF_SUFFIX.items()}
)
STREAMED: Final = frozenset({TableFormat.CSV, TableFormat.JSON_LINES, TableFormat.ARROW})
ARROW_COMPRESSION: Final = (
    "lz4"  # most cells of a wide table are empty, and take longer to be written than to be packed
)
_TEXT: Final = "string"


def check_libraries(table_format: TableFormat, logs: Sequence[Path]) -> None:
    """Raise ExtraMissingError if a library is missing that writes a format, or that logs need, as their names say."""
    is_mf4 = table_format is TableFormat.MF4
    needs = [("asammdf" if is_mf4 else "pyarrow", "mf4" if is_mf4 else "parquet")]
    if PathFinder.find_spec(needs[0][0]) is not None:
        return  # what a log needs in spite of its name, its contents say
    words = [f"{table_format} needs {needs[0][0]}"]
    suffixes = {suffix.lower() for log in logs for suffix in log.suffixes}
    if not is_mf4 and suffixes & {".mf4", ".mdf"}:
        needs.append(("asammdf", "mf4"))
        words.append("MF4 logs need asammdf")
    if suffixes & {".zst", ".zstd"}:
        needs.append(("zstandard", "zstd"))
        words.append("logs inside zstd need zstandard")
    missing = [number for number, (module, _) in enumerate(needs) if PathFinder.find_spec(module) is None]
    extras = sorted({needs[number][1] for number in missing})
    raise extra_missing(", ".join(words[number] for number in missing), ",".join(extras))


class ColumnSink(Protocol):
    """A file of columns that grows by groups of rows."""

    def write_columns(self, columns: Mapping[str, Any]) -> None:
        """Write arrays of one length, one per column in their order."""

    def close(self) -> None:
        """Write what the format needs at its end."""

    def discard(self) -> None:
        """Leave it as it is: it is not complete."""


def open_columns(
    output: BinaryIO,
    table_format: TableFormat,
    kinds: Mapping[str, str],
    metadata: Mapping[str, Mapping[str, str]],
) -> ColumnSink:
    """Begin a table of columns, named with their types as of ``ParquetTable``.

    Raises
    ------
    ExtraMissingError
        If pyarrow is not installed.
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


class _ArrowStream:
    """What ``pyarrow.ipc.open_stream`` reads."""

    def __init__(self, output: BinaryIO, kinds: Mapping[str, str], metadata: Mapping[str, Mapping[str, str]]) -> None:
        self._arrow = load_pyarrow()
        self._output = output
        self._schema = arrow_schema(kinds, metadata)
        options = self._arrow.ipc.IpcWriteOptions(compression=ARROW_COMPRESSION)
        self._writer = self._arrow.ipc.new_stream(output, self._schema, options=options)

    def write_columns(self, columns: Mapping[str, Any]) -> None:
        self._writer.write_batch(self._arrow.record_batch(list(columns.values()), schema=self._schema))
        self._output.flush()

    def close(self) -> None:
        self._writer.close()

    def discard(self) -> None:
        """Write no end, so that a reader notices."""


class _Csv:
    """A line of names, then a line per row; times as ISO 8601, an empty cell for what is not there."""

    def __init__(self, output: BinaryIO, kinds: Mapping[str, str]) -> None:
        self._arrow = load_pyarrow()
        self._output = output
        texts = {name: _TEXT if kind in {TIME_TYPE, NAME_TYPE} else kind for name, kind in kinds.items()}
        self._kinds = kinds
        self._schema = arrow_schema(texts)
        from pyarrow import csv  # noqa: PLC0415 - optional

        self._writer = csv.CSVWriter(output, self._schema, write_options=csv.WriteOptions(quoting_style="needed"))

    def write_columns(self, columns: Mapping[str, Any]) -> None:
        plain = [_as_text(column, self._kinds[name]) for name, column in columns.items()]
        self._writer.write_batch(self._arrow.record_batch(plain, schema=self._schema))
        self._output.flush()

    def close(self) -> None:
        self._writer.close()

    def discard(self) -> None:
        """Close it: whoever reads it is told that something went wrong."""
        self._writer.close()


class _JsonLines:
    """An object per row, without what is not there; a number that is none is null."""

    def __init__(self, output: BinaryIO, kinds: Mapping[str, str]) -> None:
        load_pyarrow()
        self._output = output
        self._kinds = kinds

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

    def discard(self) -> None:
        """Nothing."""


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
