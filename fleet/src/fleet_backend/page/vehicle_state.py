"""What few rows tell of a vehicle: whether it is there, its fluids, and whether anything new is stored of it."""

from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final

from sqlalchemy import BigInteger, Connection, Engine, Select, bindparam, cast, func, literal_column, select

from fleet_backend.database import transaction
from fleet_backend.months import CLUTCH_STREAM, has_partitions
from fleet_backend.office_tables import ALARM, POPULATION
from fleet_backend.page.records import Fill
from fleet_backend.schema import FLUID_FILL, RANKED_AT, SHIFT_RESULT, VEHICLE, UtcDateTime
from fleet_contract.orders import distinct

_OWN: Final[Any] = bindparam("vehicle")
_STEPS: Final = func.count() + func.count(ALARM.c.cleared_at) + func.count(ALARM.c.acknowledged_at)
_ABOUT: Final = select(
    VEHICLE.c.is_online,
    VEHICLE.c.connected_at,
    VEHICLE.c.service_version,
    select(_STEPS).where(ALARM.c.vehicle == _OWN).scalar_subquery().label("alarm_step_count"),
    select(func.max(POPULATION.c.version)).scalar_subquery().label("population_version"),
).where(VEHICLE.c.vehicle == _OWN)
_STORED: Final = (
    select(
        SHIFT_RESULT.c.clutch,
        func.count(),
        func.max(SHIFT_RESULT.c.stored_at),
        func.max(literal_column(RANKED_AT["sqlite"].format(""), UtcDateTime())),
    )
    .where(SHIFT_RESULT.c.vehicle == _OWN)
    .group_by(SHIFT_RESULT.c.clutch)
    .order_by(SHIFT_RESULT.c.clutch)
)
_STREAMS: Final = CLUTCH_STREAM.c
_STORED_BY_MONTH: Final = (
    select(
        _STREAMS.clutch,
        cast(func.sum(_STREAMS.result_count), BigInteger),
        func.max(_STREAMS.last_stored_at),
        func.max(_STREAMS.last_at),
    )
    .where(_STREAMS.vehicle == _OWN)
    .group_by(_STREAMS.clutch)
    .order_by(_STREAMS.clutch)
)
_FILLS: Final[Select[Any]] = (
    select(FLUID_FILL.c.filled_at, FLUID_FILL.c.odometer_m, FLUID_FILL.c.product, FLUID_FILL.c.note)
    .where(FLUID_FILL.c.vehicle == _OWN)
    .order_by(FLUID_FILL.c.filled_at)
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Stored:
    """What is stored of a clutch, all versions of its results counted."""

    clutch: int
    result_count: int
    stored_at: datetime | None  # the last of them
    produced_at: datetime | None  # the newest of them, or when it happened if that is earlier


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleState:
    """What is known of a vehicle; what was worked out of its results holds for as long as all of it stays the same."""

    is_online: bool | None  # as its service said
    connected_at: datetime | None
    service_version: str | None
    alarm_step_count: int  # how often an alarm was raised, cleared or acknowledged
    population_version: int | None  # of the fleet, the newest
    fills: tuple[Fill, ...]  # the earliest first
    stored: tuple[Stored, ...]

    @property
    def last_result_at(self) -> datetime | None:
        return max((one.produced_at for one in self.stored if one.produced_at is not None), default=None)

    def stored_of(self, clutch: int) -> Stored:
        nothing = Stored(clutch=clutch, result_count=0, stored_at=None, produced_at=None)
        return next((one for one in self.stored if one.clutch == clutch), nothing)


def state_of(engine: Engine, vehicle: str) -> VehicleState | None:
    """Return the state of a vehicle; None if nothing was ever heard of it."""
    own = {"vehicle": vehicle}
    with transaction(engine) as connection:
        row = connection.execute(_ABOUT, own).mappings().first()
        if row is None:
            return None
        stored = connection.execute(_STORED_BY_MONTH if has_partitions(engine) else _STORED, own).all()
        fills = fills_in(connection, vehicle)
    is_online = None if row["is_online"] is None else bool(row["is_online"])
    names = ("clutch", "result_count", "stored_at", "produced_at")
    return VehicleState(
        **{**row, "is_online": is_online},
        fills=fills,
        stored=tuple(Stored(**dict(zip(names, one, strict=True))) for one in stored),
    )


def fills_of(engine: Engine, vehicle: str) -> tuple[Fill, ...]:
    """Return the fluid fills of a vehicle, the earliest first."""
    with transaction(engine) as connection:
        return fills_in(connection, vehicle)


def fills_in(connection: Connection, vehicle: str) -> tuple[Fill, ...]:
    """Return the same of an open connection."""
    rows = connection.execute(_FILLS, {"vehicle": vehicle}).mappings()
    return tuple(distinct((Fill(**row) for row in rows), lambda one: one.filled_at))
