"""The past of one clutch with what follows from it, as pages show it: made once for what is stored."""

from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Engine

from diag_service.diagnosis.prognosis import Prognosis
from fleet_backend.page import past
from fleet_backend.page.outlook import OTHER_CALIBRATION, answer_of, outlook_of
from fleet_backend.page.populations import latest
from fleet_backend.page.records import OutlookAnswer, TrendPoint
from fleet_backend.page.vehicle_state import VehicleState
from fleet_backend.schema import RUNNING

_POINT_NAMES: Final = (
    *("vehicle", "clutch", "end_at", "odometer_m", "kind", "status", "mu_c", "std_mu_c", "random_std_mu_c", "mu_s"),
    *("std_mu_s", "level_ratio", "condition", "stream", "seq", "algorithm_version", "calibration_version"),
)
_RUNNING_NAMES: Final = ("mu_c", "std_mu_c", "mu_s", "std_mu_s", "correlation")


@dataclass(frozen=True, slots=True, kw_only=True)
class Past:
    """The past of a clutch, and what follows from it."""

    trend: tuple[TrendPoint, ...]
    prognosis: Prognosis | None
    outlook: OutlookAnswer | None  # the same, as it is told
    why_no_outlook: str | None


def read_past(engine: Engine, vehicle: str, clutch: int, state: VehicleState, service_distance_m: float) -> Past:
    """Read the past of a clutch, and work out how far its fluid will go."""
    rows = past.results_of(engine, vehicle, clutch)
    kept = None if state.population_version is None else latest(engine)
    found = outlook_of(clutch, rows, state.fills, service_distance_m, kept) if rows else None
    return Past(
        trend=tuple(map(point_of, rows)),
        prognosis=found,
        outlook=None if found is None else answer_of(found, rows),
        why_no_outlook=OTHER_CALIBRATION if found is None else None,
    )


def point_of(row: past.Row) -> TrendPoint:
    """Return one event of a trend."""
    made: dict[str, Any] = {name: row[name] for name in _POINT_NAMES}
    made |= {f"running_{name}": row[RUNNING + name] for name in _RUNNING_NAMES}
    return TrendPoint(reasons=past.words_in(row), **made)
