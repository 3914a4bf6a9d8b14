"""The running condition of clutches, read for the whole fleet or for some vehicles: an index look-up per clutch."""

import gc
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import datetime
from types import MappingProxyType
from typing import Any, Final

from sqlalchemy import Connection, Engine, TextualSelect, bindparam, func, select, text

from fleet_backend.database import transaction
from fleet_backend.months import CLUTCH_STREAM, has_partitions
from fleet_backend.page.calibrations import remember
from fleet_backend.page.records import ClutchNow
from fleet_backend.queries import PresentFluid, clutch_names, present_fluids, with_orders
from fleet_backend.schema import FLUID_FILL, HAPPENED_AT, RANKED_AT, SHIFT_RESULT, WITHDRAWN_FILL, UtcDateTime
from fleet_backend.views import LAST_RESULTS

_MOST_NAMES: Final = 500  # of vehicles in one statement
# The view running_condition for some vehicles alone: a database does not carry a list of names into a view by itself.
_RUNNING: Final = """
SELECT s.vehicle, s.clutch, s.condition, s.condition_reason, s.advice, s.level_ratio,
  s.running_shift_count AS shift_count, s.running_mu_c AS mu_c, s.running_mu_s AS mu_s,
  s.running_std_mu_c AS std_mu_c, s.running_std_mu_s AS std_mu_s, s.running_correlation AS correlation,
  s.running_slope_s_rad AS slope_s_rad, s.running_std_slope_s_rad AS std_slope_s_rad,
  s.running_probability_negative_slope AS probability_negative_slope,
  s.odometer_m, s.end_at, s.stored_at, {happened_at} AS happened_at, s.stream, s.seq,
  s.algorithm_version, s.calibration_version, NULL AS fluid,
  s.causes, s.running_since_bus_ns, {score} AS score
FROM {source}
"""
# LIMIT keeps PostgreSQL from joining all months at once: one look into one part per clutch, however many there are.
_BY_MONTH: Final = """(
  SELECT DISTINCT ON (k.vehicle, k.clutch) k.* FROM clutch_stream AS k {where}
  ORDER BY k.vehicle, k.clutch, k.last_at DESC, k.stream DESC
) AS p
CROSS JOIN LATERAL (
  SELECT * FROM shift_result AS r
  WHERE r.vehicle = p.vehicle AND r.stream = p.stream AND r.seq = p.last_seq
    AND r.version_rank = p.last_version_rank AND r.produced_at = p.last_produced_at
  LIMIT 1
) AS s
"""
_SCORE_OF_JSON: Final = "CAST(CAST(s.shift_quality AS json) ->> 'score' AS double precision)"
_NAMES: Final = tuple(field.name for field in fields(ClutchNow))


@dataclass(frozen=True, slots=True, kw_only=True)
class FillsSeen:
    """What tells whether fluid fills were noted since one looked last."""

    count: int
    latest: datetime | None
    withdrawn_count: int = 0


def _statements(where: str) -> Mapping[bool, TextualSelect]:
    """Return the statement for databases that keep results by months, and for others."""
    sources = {True: (_BY_MONTH, _SCORE_OF_JSON), False: (LAST_RESULTS, "json_extract(s.shift_quality, '$.score')")}
    found: dict[bool, TextualSelect] = {}
    for kind, (form, score) in sources.items():
        source = form.format(where=where, l_at=RANKED_AT["sqlite"].format("l."))
        made = text(_RUNNING.format(source=source, score=score, happened_at=HAPPENED_AT.format("s.")))
        made = made.bindparams(bindparam("vehicles", expanding=True)) if where else made
        found[kind] = made.columns(end_at=UtcDateTime(), stored_at=UtcDateTime(), happened_at=UtcDateTime())
    return MappingProxyType(found)


_ALL_CLUTCHES: Final = _statements("")
_SOME_CLUTCHES: Final = _statements("WHERE k.vehicle IN :vehicles")


class DatabaseSource:
    """Reads the fleet from a database."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def all_clutches(self) -> Sequence[ClutchNow]:
        """Return the running condition of every clutch of the fleet."""
        gc.disable()  # nothing of it is garbage: looking for some again and again takes a fifth of the time
        try:
            with transaction(self._engine) as connection:
                rows = connection.execute(_ALL_CLUTCHES[has_partitions(self._engine)]).mappings()
                return _told(connection, with_orders(rows, present_fluids(connection), clutch_names(connection)))
        finally:
            gc.enable()

    def clutches_of(self, vehicles: Sequence[str]) -> Sequence[ClutchNow]:
        statement, found = _SOME_CLUTCHES[has_partitions(self._engine)], list[ClutchNow]()
        with transaction(self._engine) as connection:
            for first in range(0, len(vehicles), _MOST_NAMES):
                names = list(vehicles[first : first + _MOST_NAMES])
                rows = connection.execute(statement, {"vehicles": names}).mappings()
                found += _told(
                    connection, with_orders(rows, present_fluids(connection, names), clutch_names(connection))
                )
        return found

    def vehicles_with_news(self, since: datetime) -> Sequence[str]:
        """Return the vehicles of which results were stored at or after a moment."""
        streams, results = CLUTCH_STREAM.c, SHIFT_RESULT.c
        statement = (
            select(streams.vehicle).where(streams.last_stored_at >= since)  # a row for thousands of results
            if has_partitions(self._engine)
            else select(results.vehicle).where(results.stored_at >= since)
        ).distinct()
        with transaction(self._engine) as connection:
            return [str(name) for name in connection.execute(statement).scalars()]

    def now(self) -> datetime:
        """Return what time it is where results are stored."""
        with transaction(self._engine) as connection:
            return connection.execute(select(func.current_timestamp(type_=UtcDateTime()))).scalar_one()

    def fluids(self) -> Mapping[str, PresentFluid]:
        """Return the fluid of each vehicle of which a fill is known."""
        with transaction(self._engine) as connection:
            return present_fluids(connection)

    def fills_seen(self) -> FillsSeen:
        """Return how many fluid fills are noted and taken back, and the latest."""
        with transaction(self._engine) as connection:
            count, latest = connection.execute(select(func.count(), func.max(FLUID_FILL.c.filled_at))).one()
            withdrawn_count = connection.execute(select(func.count()).select_from(WITHDRAWN_FILL)).scalar_one()
        return FillsSeen(count=count, latest=latest, withdrawn_count=withdrawn_count)


def last_arrivals(engine: Engine) -> dict[str, datetime]:
    """Return when a result of each vehicle was stored last, by the database's clock."""
    table, stored_at = (
        (CLUTCH_STREAM, CLUTCH_STREAM.c.last_stored_at)
        if has_partitions(engine)
        else (SHIFT_RESULT, SHIFT_RESULT.c.stored_at)
    )
    with transaction(engine) as connection:
        rows = connection.execute(select(table.c.vehicle, func.max(stored_at)).group_by(table.c.vehicle))
        return {str(vehicle): at for vehicle, at in rows if at is not None}


def _told(connection: Connection, rows: Iterable[Mapping[str, Any]]) -> list[ClutchNow]:
    """Return clutches, of whose calibrations is known what their vehicles told."""
    found = [ClutchNow(**{name: row[name] for name in _NAMES}) for row in rows]
    remember(connection, ((one.vehicle, one.calibration_version) for one in found))
    return found
