"""What the fluids of the fleet have in common, by type and fluid: learned, and kept in the database by versions."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import lru_cache
from itertools import chain
from pathlib import Path

from sqlalchemy import Engine, func, insert, select

from clutch_model.calibration import FrictionCurve
from clutch_results.prognosis import (
    Ageing,
    Common,
    History,
    Monthly,
    PeerGroup,
    Population,
    ageings,
    common_of,
    learn,
    monthly,
    population_from,
    population_record,
)
from fleet_backend.ageing.prognosis import BEYOND_NUMBERS, estimate_of, known_history
from fleet_backend.ageing.records import Fill
from fleet_backend.ageing.results import fills_of, results_of
from fleet_backend.database import transaction
from fleet_backend.errors import BackendConfigError, DatabaseError
from fleet_backend.office_tables import POPULATION, note_change
from fleet_backend.schema import CLUTCH

Key = tuple[str, int]  # vehicle and clutch
Record = Mapping[str, object]


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetAgeing:
    """What was learned of a fleet; JSON-ready records."""

    population: Population
    usual: Sequence[Record]
    clutch_count: int  # looked at
    left_out_count: int  # of them: of a calibration that is not at hand, or of numbers of no clutch


def fleet_ageing(engine: Engine) -> FleetAgeing:
    """Learn from all clutches of a fleet, one after the other.

    They do not fit into memory together, so they are read twice: for what all share, then without that.
    """
    with transaction(engine) as connection:
        order = (CLUTCH.c.vehicle, CLUTCH.c.clutch)
        keys = [(str(vehicle), int(clutch)) for vehicle, clutch in connection.execute(select(*order).order_by(*order))]
    months: dict[str, list[Monthly]] = {}
    for key in keys:
        if (known := _history(engine, key, {})) is not None:
            months.setdefault(known[2], []).extend(monthly(known[0]))
    shared = {vehicle_type: common_of(clutches) for vehicle_type, clutches in months.items()}
    common = {vehicle_type: course for vehicle_type, course in shared.items() if course is not None}
    lives = [_ageings(engine, key, common) for key in keys]
    known_lives = [life for life in lives if life is not None]
    population = replace(learn(chain.from_iterable(known_lives)), common=common)
    return FleetAgeing(
        population=population,
        usual=list(_usual(population)),
        clutch_count=len(keys),
        left_out_count=len(keys) - len(known_lives),
    )


def _history(
    engine: Engine, key: Key, common: Mapping[str, Common]
) -> tuple[History, FrictionCurve, str, tuple[Fill, ...]] | None:
    """Return a clutch without what its type shares, as `known_history` does, and the fills of its vehicle."""
    vehicle, clutch = key
    rows, fills = results_of(engine, vehicle, clutch), fills_of(engine, vehicle)
    known = known_history(clutch, rows, [estimate_of(row) for row in rows], fills, common)
    return None if known is None else (*known, fills)


def _ageings(engine: Engine, key: Key, common: Mapping[str, Common]) -> list[Ageing] | None:
    """Return what the fluids of a clutch say; None: its calibration is not known, or its numbers are of no clutch."""
    known = _history(engine, key, common)
    if known is None:
        return None
    history, reference, vehicle_type, fills = known
    kinds = [PeerGroup(vehicle_type=vehicle_type, fluid=name) for name in (None, *(fill.product for fill in fills))]
    try:
        return ageings(history, reference, kinds)
    except BEYOND_NUMBERS:
        return None


def _usual(population: Population) -> Iterator[Record]:
    for peers in population.peers:
        for name, usual in peers.channels.items():
            yield {
                "record": "usual",
                "vehicle_type": peers.kind.vehicle_type,
                "fluid": peers.kind.fluid,
                "channel": name.value,
                "life_count": peers.life_count,
                "start": usual.start,
                "start_std": usual.start_std,
                "loss_per_m": usual.loss_per_m,
                "loss_log_std": usual.loss_log_std,
                "bend_life_count": peers.bend_life_count,
                "bend_chance": peers.bend_chance,
            }


def keep_population(engine: Engine, population: Population, clutch_count: int, *, at: datetime, by: str) -> int:
    """Store a population as the next version, and return that; ``by`` is who keeps it, for the audit."""
    with transaction(engine) as connection:
        version = 1 + int(connection.scalar(select(func.coalesce(func.max(POPULATION.c.version), 0))) or 0)
        content = json.dumps(population_record(replace(population, version=version)), ensure_ascii=False)
        row = {"version": version, "learned_at": at, "clutch_count": clutch_count, "content": content}
        connection.execute(insert(POPULATION).values(row))
        note_change(connection, "keep population", f"population {version}, from {clutch_count} clutches", at=at, by=by)
    return version


def write_population(path: Path, population: Population, version: int | None) -> None:
    """Write a population as JSON; raises ConfigError where that cannot be done."""
    record = population_record(replace(population, version=version))
    try:
        path.write_text(json.dumps(record, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")
    except OSError as exc:
        raise BackendConfigError(f"cannot write {path}: {exc.strerror}") from exc


def latest_population(engine: Engine) -> Population | None:
    """Return the population that was kept last; None: none was.

    Raises
    ------
    DatabaseError
        If it is of a newer program.
    """
    statement = select(POPULATION.c.content).order_by(POPULATION.c.version.desc()).limit(1)
    with transaction(engine) as connection:
        content = connection.scalar(statement)
    return None if content is None else _population(content)


@lru_cache(maxsize=4)
def _population(content: str) -> Population:
    try:
        return population_from(json.loads(content))
    except ValueError as exc:
        raise DatabaseError(f"the population in the database cannot be used: {exc}") from exc
