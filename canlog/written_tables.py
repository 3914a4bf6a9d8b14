"""Signals of logs of any size as tables in files."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

from cantools.database.can import Database, Message

from canlog.database.loading import database_of
from canlog.errors import OutputError
from canlog.tables.account import losses
from canlog.tables.decoding import Plan, TableShape, decode_logs
from canlog.tables.inputs import log_paths
from canlog.tables.layouts import TableShapeName, Values, ValuesName
from canlog.tables.outputs import FORMAT_OF_SUFFIX, TableFormat

FormatName = Literal["parquet", "csv", "jsonl", "arrow", "mf4"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TableChoice:
    """What of some logs is written as a table, and how.

    Parameters
    ----------
    table_format : {"parquet", "csv", "jsonl", "arrow", "mf4"}, optional
        By default what the suffix says: ``.parquet``, ``.csv``, ``.jsonl``, ``.arrows``, ``.mf4``; of a folder Parquet.
    shape, values
        As of ``Log.to_arrow``; ``messages`` is a folder with a table for each message, and the default where the output
        is a folder or has no suffix, ``wide`` that of a file. An MF4 file has a group for each message, and numbers.
    signals
        Only these: ``Message.Signal`` or the signal alone, both with ``*`` for anything; by default all. A text is one.
    begin, end
        Only what lies between: seconds from the first frame, or a time as ISO 8601, in UTC unless it says otherwise.
    columns
        Which column of a text is which, as of ``read``.
    pairs
        Identifiers, with flags, of requests and of answers in several frames, besides those of ISO 15765-4.
    """

    table_format: FormatName | None = None
    shape: TableShapeName | None = None
    values: ValuesName = "numbers"
    signals: Sequence[str] | str = ()
    begin: str | float | None = None
    end: str | float | None = None
    columns: str = ""
    pairs: Collection[tuple[int, int]] = ()

    def plan(self, messages: Sequence[Message]) -> Plan:
        """Return what is decoded of the messages of a database; raises as ``Plan.part`` does."""
        whole = Plan.of(messages, TableShape(self.shape or "wide"), Values(self.values))
        return replace(whole, pairs=tuple(self.pairs)).part(self.signals, self.begin, self.end)

    def format_of(self, output: Path) -> TableFormat:
        """Return the format of a file; raises OutputError if there is no such format, or it cannot hold this."""
        if self.shape == "messages" and self.table_format is None:
            return TableFormat.PARQUET
        try:
            chosen = (
                FORMAT_OF_SUFFIX[output.suffix.lower()] if self.table_format is None else TableFormat(self.table_format)
            )
        except (KeyError, ValueError):
            known = f"{', '.join(FORMAT_OF_SUFFIX)}, or as table_format says: {', '.join(TableFormat)}"
            raise OutputError(f"{output}: signals are written as {known}") from None
        if chosen is TableFormat.MF4 and (self.shape or "wide", self.values) != ("wide", "numbers"):
            raise OutputError("an MF4 file has a group for each message, and numbers: neither shape nor values applies")
        return chosen


EVERY_SIGNAL: Final = TableChoice()


def default_shape(output: Path, table_format: str | None = None, *, is_folder: bool = False) -> TableShapeName:
    """Return the shape where nobody said it: in a folder each message has a table, and one table is wide.

    ``is_folder``: whatever the output is called, since each of several logs gets a folder of its own there.
    """
    is_one_table = str(output) == "-" or (output.suffix != "" and not output.is_dir() and not is_folder)
    return "wide" if is_one_table or table_format == TableFormat.MF4 else "messages"


def write_table(
    path: Path | str | Sequence[Path | str],
    database: Database | Path | str,
    output: Path | str,
    choice: TableChoice = EVERY_SIGNAL,
    *,
    is_lenient: bool = False,
) -> list[str]:
    """Write the signals of logs into a table, in bounded memory; return what is missing there, in words.

    Parameters
    ----------
    path, database, is_lenient
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
    choice = replace(choice, shape=choice.shape or default_shape(written, choice.table_format))
    plan = choice.plan(database_of(database, is_lenient=is_lenient).messages)
    decoded = decode_logs(log_paths(path), plan, written, choice.format_of(written), columns=choice.columns)
    return list(losses(decoded.account))


def write_parquet(
    path: Path | str | Sequence[Path | str],
    database: Database | Path | str,
    output: Path | str,
    choice: TableChoice = EVERY_SIGNAL,
    *,
    is_lenient: bool = False,
) -> list[str]:
    """Write the signals of logs into a Parquet file, whatever it is called: what ``write_table`` does."""
    choice = replace(choice, table_format="parquet", shape=choice.shape or "wide")
    return write_table(path, database, output, choice, is_lenient=is_lenient)
