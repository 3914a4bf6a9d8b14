"""The wire contract: the databases of the emulated vehicles, checked."""

from pathlib import Path
from typing import Final

import cantools
from cantools.database.can import Database

DBC_PATH: Final = Path(__file__).with_name("dct.dbc")


def dbc_path(transmission: str) -> Path:
    """Return the database of the vehicle with a transmission: its own, or that of the dual clutches."""
    own = DBC_PATH.with_name(f"{transmission}.dbc")
    return own if own.exists() else DBC_PATH


def load_contract(transmission: str = "nominal") -> Database:
    """Return this project's database, checked strictly: no overlaps, nothing outside its message."""
    path = dbc_path(transmission)
    database = cantools.database.load_file(path, database_format="dbc", strict=True)
    if not isinstance(database, Database):
        raise TypeError(f"{path.name} is not a CAN database")
    return database
