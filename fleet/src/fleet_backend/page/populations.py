"""What was learned of the fleet, version by version, in the database."""

import json
from dataclasses import dataclass, replace
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import Final

from sqlalchemy import Engine, func, insert, select

from clutch_results.prognosis import Population, population_from, population_record
from fleet_backend.database import transaction
from fleet_backend.errors import BackendConfigError, DatabaseError
from fleet_backend.office_tables import COMMAND_LINE, POPULATION, note_change

_KEPT_IN_MEMORY: Final = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredPopulation:
    """A population with its version."""

    version: int
    learned_at: datetime
    population: Population


def keep(engine: Engine, population: Population, clutch_count: int, *, at: datetime, by: str) -> int:
    """Store a population as the next version, and return that; ``by`` is who keeps it, for the audit."""
    table = POPULATION
    with transaction(engine) as connection:
        version = 1 + int(connection.execute(select(func.coalesce(func.max(table.c.version), 0))).scalar_one())
        content = json.dumps(population_record(replace(population, version=version)), ensure_ascii=False)
        connection.execute(
            insert(table).values(version=version, learned_at=at, clutch_count=clutch_count, content=content)
        )
        told = f"population {version}, from {clutch_count} clutches"
        note_change(connection, at=at, who=by, role=COMMAND_LINE, action="keep population", subject=told)
    return version


def write(path: Path, population: Population, version: int | None) -> None:
    """Write a population as JSON; raises ConfigError where that cannot be done."""
    try:
        path.write_text(
            json.dumps(population_record(replace(population, version=version)), ensure_ascii=False, indent=1) + "\n",
            encoding="utf-8",
        )
    except OSError as exc:
        raise BackendConfigError(f"{path}: {exc}") from exc


def latest(engine: Engine) -> StoredPopulation | None:
    """Return the population that was kept last; None: none was.

    Raises
    ------
    DatabaseError
        If it is of a newer program.
    """
    table = POPULATION
    statement = select(table.c.version, table.c.learned_at, table.c.content).order_by(table.c.version.desc()).limit(1)
    with transaction(engine) as connection:
        row = connection.execute(statement).first()
    if row is None:
        return None
    return StoredPopulation(
        version=int(row.version), learned_at=row.learned_at, population=_population(str(row.content))
    )


@lru_cache(maxsize=_KEPT_IN_MEMORY)
def _population(content: str) -> Population:
    try:
        return population_from(json.loads(content))
    except ValueError as exc:
        raise DatabaseError(f"the population in the database cannot be used: {exc}") from exc
