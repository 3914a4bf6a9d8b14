"""The database that a user names, or the shipped one."""

from pathlib import Path

from cantools.database.can import Database

from canlog.database.loading import load_database
from dbc.contract import DBC_PATH, load_contract


def open_database(path: Path | None, *, is_lenient: bool = False) -> Database:
    """Return the database of a file, or the shipped one, which needs no care; raises DefinitionError.

    ``is_lenient`` leaves items out that cannot be right, with a warning of each, instead of refusing the file.
    """
    return load_contract() if path in {None, DBC_PATH} else load_database(path, is_lenient=is_lenient)
