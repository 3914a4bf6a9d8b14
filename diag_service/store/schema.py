"""Tables of a store, and the way from each earlier form of them to the present one."""

import sqlite3
from typing import Final

APPLICATION_ID: Final = 0x434C4449  # "CLDI", in the header of every store
SCHEMA_VERSION: Final = 5

WAITING, DELIVERED, QUARANTINED = range(3)  # values of result.published

_CONTROLLER: Final = """
CREATE TABLE controller (
  position INTEGER PRIMARY KEY AUTOINCREMENT,
  vehicle TEXT NOT NULL,
  controller TEXT NOT NULL,
  said TEXT NOT NULL,
  json TEXT NOT NULL
);
"""
_CREATE_FILL: Final = """
CREATE TABLE fill (
  vehicle TEXT NOT NULL,
  filled_at TEXT NOT NULL,
  odometer_m REAL,
  product TEXT,
  note TEXT,
  PRIMARY KEY (vehicle, filled_at)
);
"""
_WITHDRAWN: Final = "ALTER TABLE fill ADD COLUMN is_withdrawn INTEGER NOT NULL DEFAULT 0;"
_CREATE: Final = f"""
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE result (
  position INTEGER PRIMARY KEY AUTOINCREMENT,
  vehicle TEXT NOT NULL,
  stream TEXT NOT NULL,
  seq INTEGER NOT NULL,
  algorithm_version TEXT NOT NULL,
  calibration_version TEXT NOT NULL,
  clutch INTEGER NOT NULL,
  json TEXT NOT NULL,
  published INTEGER NOT NULL DEFAULT {WAITING},
  refusal TEXT,
  UNIQUE (vehicle, stream, seq, algorithm_version, calibration_version)
);
CREATE INDEX unpublished ON result (vehicle, position) WHERE published = {WAITING};
CREATE INDEX latest ON result (vehicle, clutch, position);
CREATE TABLE state (
  vehicle TEXT PRIMARY KEY,
  belief TEXT NOT NULL,
  condition TEXT NOT NULL,
  algorithm_version TEXT NOT NULL,
  calibration_version TEXT NOT NULL
);
{_CONTROLLER}
{_CREATE_FILL}
{_WITHDRAWN}
PRAGMA application_id = {APPLICATION_ID};
PRAGMA user_version = {SCHEMA_VERSION};
"""

# From the version that is the key to the next; a store goes through all that are behind its own.
_STEPS: Final = {
    1: "ALTER TABLE result ADD COLUMN refusal TEXT; PRAGMA user_version = 2;",  # why a backend cannot use a result
    2: f"{_CONTROLLER} PRAGMA user_version = 3;",  # what a controller says of its trouble codes
    3: f"{_CREATE_FILL} PRAGMA user_version = 4;",  # which fluid since when
    4: f"{_WITHDRAWN} PRAGMA user_version = 5;",  # which fills were noted by mistake
}


def create_tables(connection: sqlite3.Connection) -> None:
    """Make an empty database a store, in one transaction."""
    connection.executescript(f"BEGIN IMMEDIATE; {_CREATE} COMMIT;")


def migrate(connection: sqlite3.Connection, version: int) -> None:
    """Bring a store to the present form; each step is a transaction, so a power cut between two does no harm."""
    for step in range(version, SCHEMA_VERSION):
        connection.executescript(f"BEGIN IMMEDIATE; {_STEPS[step]} COMMIT;")
