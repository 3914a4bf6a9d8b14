"""What may be asked: the words of each address and form as records, by which they are checked and described."""

from collections.abc import Callable, Mapping
from datetime import date
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta

from fleet_backend.alarms.rules import AlarmRule
from fleet_backend.page.fleet import vehicle_type
from fleet_backend.page.records import ClutchNow, Severity

Vehicle = Annotated[
    str, Meta(pattern="^[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}$", max_length=64, description="name of the vehicle")
]
Text = Annotated[str, Meta(max_length=200)]
Count = Annotated[int, Meta(ge=1, le=2**53)]
ClutchWord = Annotated[int, Meta(ge=0, le=2, description="1 or 2; 0: the vehicle as a whole")]


class Asking(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What may be asked of a page: nothing."""


class ListQuery(Asking, frozen=True, kw_only=True):
    """What may be asked of every list."""

    offset: Annotated[int, Meta(ge=0, le=2**31, description="rows before it: `next` of the part before")] = 0
    limit: Annotated[int, Meta(ge=1, le=50_000, description="how many at most; on pages no more than 1,000")] = 50


ORDERS: Final[Mapping[str, Callable[[ClutchNow], Any]]] = MappingProxyType({
    "vehicle": lambda one: one.vehicle,
    "level": lambda one: 9.0 if one.level_ratio is None else one.level_ratio,
    "km": lambda one: -1.0 if one.odometer_m is None else one.odometer_m,  # who has no odometer is at the low end
    "fluid": lambda one: one.fluid or "",
    "type": vehicle_type,
    "last": lambda one: one.end_at.isoformat(),
})  # fmt: skip
SORTS: Final = (*ORDERS, *(f"-{name}" for name in ORDERS))


class VehiclesQuery(ListQuery, frozen=True, kw_only=True):
    """What may be asked of vehicles."""

    q: Annotated[str, Meta(max_length=64, description="a part of the vehicle's name")] | None = None
    condition: Annotated[Severity, Meta(description="verdict")] | None = None
    fluid: Annotated[str, Meta(max_length=200, description="fluid that is in, as it was noted")] | None = None
    since: Annotated[date, Meta(description="first day (UTC) of the last event")] | None = None
    until: Annotated[date, Meta(description="last day of it")] | None = None
    calibration: Annotated[str, Meta(max_length=200, description="of the results: version, or its type")] | None = None
    sort: Annotated[Literal[SORTS], Meta(description="column, - for downwards; else worst first")] | None = None  # type: ignore[valid-type]
    only: Annotated[Literal["due", "silent", "alarm"], Meta(description="due within 30 days, silent, alarm")] | None = (
        None
    )


class VehicleQuery(Asking, frozen=True, kw_only=True):
    """What may be asked of a vehicle."""

    vehicle: Vehicle
    service_km: Annotated[int, Meta(ge=1, le=300_000, description="distance to the next service [km]")] = 15_000


class ShiftQuery(Asking, frozen=True, kw_only=True):
    """Which event is meant."""

    vehicle: Vehicle
    stream: Annotated[str, Meta(pattern="^[ -~]{1,128}$", description="of results: a run of a service, or a log")]
    seq: Annotated[Count, Meta(description="position in the stream")]


class AlarmsQuery(ListQuery, frozen=True, kw_only=True):
    """What may be asked of alarms."""

    state: Annotated[Literal["open", "waiting", "all"], Meta(description="which ones (default: open)")] | None = None
    rule: Annotated[AlarmRule, Meta(description="what they are about")] | None = None


class AlarmQuery(Asking, frozen=True, kw_only=True):
    """Which alarm is meant."""

    vehicle: Vehicle
    clutch: ClutchWord
    rule: AlarmRule
    number: Count


class Acknowledgement(AlarmQuery, frozen=True, kw_only=True):
    """What a form says that acknowledges an alarm."""

    note: Annotated[str, Meta(max_length=500)] | None = None


class NewFluid(Asking, frozen=True, kw_only=True):
    """What a form says of a fluid that was changed, or of a fill that was noted by mistake."""

    vehicle: Vehicle
    product: Annotated[str, Meta(max_length=200)] | None = None
    at: Annotated[str, Meta(max_length=40)] | None = None
    odometer_km: Annotated[float, Meta(ge=0.0, le=5.0e6)] | None = None
    note: Annotated[str, Meta(max_length=500)] | None = None
    undo: Literal["yes"] | None = None


class EventsQuery(Asking, frozen=True, kw_only=True):
    """What a page that is looked at wants to hear of."""

    vehicle: Vehicle | None = None
    number: Annotated[int, Meta(ge=0, le=2**53, description="of the snapshot that the reader knows")] | None = None
