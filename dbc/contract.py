"""The wire contract: the database of the emulated vehicle, checked."""

from pathlib import Path
from typing import Final

import cantools
from cantools.database.can import Database

DBC_PATH: Final = Path(__file__).with_name("dct.dbc")


def load_contract() -> Database:
    """Return this project's database, checked strictly: no overlaps, nothing outside its message."""
    database = cantools.database.load_file(DBC_PATH, database_format="dbc", strict=True)
    if not isinstance(database, Database):
        raise TypeError(f"{DBC_PATH.name} is not a CAN database")
    return database
