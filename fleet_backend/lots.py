"""Lots: what some vehicles have in common, as the lot of their fluid or the month of building; read from a table."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Final

from sqlalchemy import Engine, bindparam, delete, insert, select

from fleet_backend.database import transaction
from fleet_backend.errors import ConfigError
from fleet_backend.office_tables import COMMAND_LINE, VEHICLE_LOT, note_change
from fleet_backend.schema import VEHICLE

VEHICLE_COLUMN: Final = "vehicle"
MOST_BYTES: Final = 64 * 2**20
LONGEST: Final = 200  # characters of a name or a value
_ROWS_PER_WRITE: Final = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class LotRow:
    """One property of one vehicle; without a value it is to be forgotten."""

    vehicle: str
    name: str
    value: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Imported:
    """What a table brought."""

    vehicle_count: int
    lot_count: int  # properties of vehicles that are known now
    unheard_count: int  # vehicles of which nothing was heard so far


def read_lots(path: Path) -> list[LotRow]:
    """Return the rows of a CSV table: a column ``vehicle``, and one for each property.

    Raises ConfigError if it cannot be read, or is no such table.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ConfigError(f"{path}: larger than {MOST_BYTES // 2**20} MiB")
        with path.open(encoding="utf-8-sig", newline="") as file:
            return list(_rows(path, csv.reader(file, strict=True)))
    except (OSError, UnicodeDecodeError, csv.Error) as exc:
        raise ConfigError(f"{path}: {exc}") from exc


def _rows(path: Path, lines: Iterator[list[str]]) -> Iterator[LotRow]:
    head = [one.strip() for one in next(lines, [])]
    if VEHICLE_COLUMN not in head or len(head) < 2 or len(set(head)) < len(head):
        raise ConfigError(f"{path}: the header must name the column {VEHICLE_COLUMN} and others, each once")
    seen: set[str] = set()
    for number, line in enumerate(lines, start=2):
        if not line:
            continue
        if len(line) != len(head):
            raise ConfigError(f"{path}, line {number}: {len(line)} values for {len(head)} columns")
        record = dict(zip(head, (one.strip() for one in line), strict=True))
        vehicle = record.pop(VEHICLE_COLUMN)
        if not vehicle or vehicle in seen:
            raise ConfigError(f"{path}, line {number}: the vehicle is missing or listed twice: {vehicle!r}")
        seen.add(vehicle)
        for text in (vehicle, *record, *record.values()):
            if not text.isprintable() or len(text) > LONGEST:
                raise ConfigError(f"{path}, line {number}: {text[:20]!r} is not a word of at most {LONGEST} characters")
        yield from (LotRow(vehicle=vehicle, name=name, value=value) for name, value in record.items() if name)


def store_lots(engine: Engine, rows: Sequence[LotRow], *, at: datetime, by: str) -> Imported:
    """Take the rows in place of what was known of the same vehicles and properties; all or none.

    ``by`` is who gave them, for the audit.
    """
    keys = [{"v": row.vehicle, "n": row.name} for row in rows]
    known = [{"vehicle": row.vehicle, "name": row.name, "value": row.value} for row in rows if row.value]
    vehicles = {row.vehicle for row in rows}
    old = delete(VEHICLE_LOT).where(VEHICLE_LOT.c.vehicle == bindparam("v"), VEHICLE_LOT.c.name == bindparam("n"))
    with transaction(engine) as connection:
        for first in range(0, len(keys), _ROWS_PER_WRITE):
            connection.execute(old, keys[first : first + _ROWS_PER_WRITE])
        for first in range(0, len(known), _ROWS_PER_WRITE):
            connection.execute(insert(VEHICLE_LOT), known[first : first + _ROWS_PER_WRITE])
        heard = {str(name) for name in connection.execute(select(VEHICLE.c.vehicle)).scalars()}
        told = f"{len(known)} properties of {len(vehicles)} vehicles"
        note_change(connection, at=at, who=by, role=COMMAND_LINE, action="read lots", subject=told)
    return Imported(vehicle_count=len(vehicles), lot_count=len(known), unheard_count=len(vehicles - heard))


def lots_of(engine: Engine) -> Mapping[str, list[tuple[str, str]]]:
    """Return the properties of each vehicle, as pairs of name and value."""
    table = VEHICLE_LOT
    found: dict[str, list[tuple[str, str]]] = {}
    with transaction(engine) as connection:
        for row in connection.execute(select(table).order_by(table.c.vehicle, table.c.name)):
            found.setdefault(row.vehicle, []).append((row.name, row.value))
    return found
