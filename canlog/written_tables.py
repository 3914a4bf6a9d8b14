"""Signals of logs of any size as tables in files."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from cantools.database.can import Database

from canlog.database.loading import database_of
from canlog.errors import OutputError
from canlog.tables.decoding import Plan, TableShape, decode_logs
from canlog.tables.inputs import log_paths
from canlog.tables.layouts import ShapeName, Values, ValuesName
from canlog.tables.outputs import FORMAT_OF_SUFFIX, TableFormat
from canlog.tables.report import losses

FormatName = Literal["parquet", "csv", "jsonl", "arrow", "mf4"]


def write_table(
    path: Path | str | Sequence[Path | str],
    database: Database | Path | str,
    output: Path | str,
    *,
    table_format: FormatName | None = None,
    shape: ShapeName = "wide",
    values: ValuesName = "numbers",
    signals: Sequence[str] = (),
    begin: str | float | None = None,
    end: str | float | None = None,
    is_lenient: bool = False,
    columns: str = "",
    pairs: Collection[tuple[int, int]] = (),
) -> list[str]:
    """Write the signals of logs into a table, in bounded memory; return what is missing there, in words.

    Parameters
    ----------
    path, database, is_lenient, columns
        As of ``read``.
    output
        The table, which appears when it is complete; one that is there is replaced.
    table_format : {"parquet", "csv", "jsonl", "arrow", "mf4"}, optional
        By default what the suffix says: ``.parquet``, ``.csv``, ``.jsonl``, ``.arrows``, ``.mf4``.
    shape, values
        As of ``Log.to_arrow``; an MF4 file has a group for each message, and numbers.
    signals
        Only these: ``Message.Signal`` or the signal alone, both with ``*`` for anything; by default all.
    begin, end
        Only what lies between: seconds from the first frame, or a time as ISO 8601, in UTC unless it says otherwise.
    pairs
        Identifiers, with flags, of requests and of answers in several frames, besides those of ISO 15765-4.

    Raises
    ------
    SourceError, DefinitionError, ExtraMissingError
        As ``read`` and ``Log.to_arrow`` do.
    OutputError
        If there is no such format, or the file cannot be written.
    """
    messages = database_of(database, is_lenient=is_lenient).messages
    whole = replace(Plan.of(messages, TableShape(shape), Values(values)), pairs=tuple(pairs))
    plan = whole.part(signals, begin, end)
    chosen = _format(Path(output), table_format)
    if chosen is TableFormat.MF4 and (shape, values) != ("wide", "numbers"):
        raise OutputError("an MF4 file has a group for each message, and numbers: neither shape nor values applies")
    return list(losses(decode_logs(log_paths(path), plan, Path(output), chosen, columns=columns).account))


def write_parquet(
    path: Path | str | Sequence[Path | str],
    database: Database | Path | str,
    output: Path | str,
    *,
    shape: ShapeName = "wide",
    values: ValuesName = "numbers",
    is_lenient: bool = False,
    columns: str = "",
) -> list[str]:
    """Write the signals of logs into a Parquet file, whatever it is called: what ``write_table`` does."""
    return write_table(
        path,
        database,
        output,
        table_format="parquet",
        shape=shape,
        values=values,
        is_lenient=is_lenient,
        columns=columns,
    )


def _format(output: Path, named: str | None) -> TableFormat:
    try:
        return FORMAT_OF_SUFFIX[output.suffix.lower()] if named is None else TableFormat(named)
    except (KeyError, ValueError):
        known = f"{', '.join(FORMAT_OF_SUFFIX)}, or as table_format says: {', '.join(TableFormat)}"
        raise OutputError(f"{output}: signals are written as {known}") from None
