"""The database that a user names, or the shipped one."""

from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace

from cantools.database.can import Database

from canlog.database.loading import PARSER_TIME_S, load_database
from canlog.database.signal_columns import columns_database
from canlog.logs import is_folder, table_columns
from dbc.contract import DBC_PATH, load_contract


def open_database(
    path: Path | None,
    logs: Iterable[Path] = (),
    *,
    is_lenient: bool = False,
    is_j1939: bool = False,
    parser_time_s: int | None = None,
) -> Database:
    """Return the database of a file, as `load_database` does; without one that of logs which are tables of signals.

    If there are none either, the shipped one, which needs no care.

    Raises DefinitionError, and SourceError if one of the logs cannot be read.
    """
    named = () if path is not None else [one for log in logs if not is_folder(log) for one in table_columns(log)]
    if named:
        return columns_database(named)
    if path is None or path == DBC_PATH:
        return load_contract()
    return load_database(path, is_lenient=is_lenient, is_j1939=is_j1939, parser_time_s=parser_time_s or PARSER_TIME_S)


def asked_database(options: SimpleNamespace) -> Database:
    """Return the database that a command line names, read as that says; raises DefinitionError."""
    return open_database(
        options.dbc,
        getattr(options, "logs", ()),
        is_lenient=options.lenient,
        is_j1939=getattr(options, "match", "") == "group",
        parser_time_s=options.parser_time,
    )
