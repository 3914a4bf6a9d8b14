"""Which database a log is read by: the one that was named, that of a table's columns, or the shipped one."""

from collections.abc import Callable, Iterable
from pathlib import Path

from cantools.database.can import Database

from canlog.database.loading import load_database
from canlog.database.signal_columns import columns_database
from canlog.logs import STANDARD_INPUT, table_columns
from canlog.logs.streams import never
from dbc.contract import DBC_PATH, load_contract


def open_database(
    path: Path | None,
    logs: Iterable[Path] = (),
    *,
    is_j1939: bool = False,
    is_stopped: Callable[[], bool] = never,
    columns: str = "",
) -> Database:
    """Return the database of a file, as `load_database` does; without one that of logs which are tables of signals.

    If there are none either, the shipped one, which needs no care.

    Raises DefinitionError, and SourceError if one of the logs cannot be read.
    """
    tables = () if path is not None else [one for one in logs if one == STANDARD_INPUT or not one.is_dir()]
    if named := [one for log in tables for one in table_columns(log, is_stopped=is_stopped, columns=columns)]:
        return columns_database(named)
    if path is None or path == DBC_PATH:
        return load_contract()
    return load_database(path, is_j1939=is_j1939)
