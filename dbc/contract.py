"""The wire contract: the databases of the emulated vehicles, checked."""

from functools import cache
from pathlib import Path
from typing import Final

from cantools.database.can import Database

DBC_PATH: Final = Path(__file__).with_name("dct.dbc")


def dbc_path(transmission: str) -> Path:
    """Return the database of the vehicle with a transmission: its own, or that of the dual clutches."""
    path = DBC_PATH.with_name(f"{transmission}.dbc")
    return path if path.exists() else DBC_PATH


@cache  # nobody changes it
def load_contract(transmission: str = "nominal") -> Database:
    """Return this project's database, checked strictly: no overlaps, nothing outside its message."""
    database = Database(strict=True)
    database.add_dbc_file(dbc_path(transmission))
    return database
