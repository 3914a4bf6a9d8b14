"""The parameters of each address and form as records, by which they are checked."""

from collections.abc import Callable, Mapping
from datetime import date
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta

from fleet_backend.ageing.records import ClutchNow, Severity
from fleet_backend.alarms.rules import AlarmRule
from fleet_backend.page.fleet import vehicle_type

Vehicle = Annotated[str, Meta(pattern="^[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}$")]
NO_CONTROLS: Final = r"^[^\u0000-\u001f\u007f-\u009f]*$"
Count = Annotated[int, Meta(ge=1, le=2**53)]


class Parameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The parameters of a page: none."""


class ListQuery(Parameters, frozen=True, kw_only=True):
    """The part of a list: ``next`` of the part before is the ``offset`` of this one; pages show 1,000 rows at most."""

    offset: Annotated[int, Meta(ge=0, le=2**31)] = 0
    limit: Annotated[int, Meta(ge=1, le=50_000)] = 50


ORDERS: Final[Mapping[str, Callable[[ClutchNow], Any]]] = MappingProxyType({
    "vehicle": lambda now: now.vehicle,
    "tier": lambda now: now.tier or 0,
    "level": lambda now: 9.0 if now.level_ratio is None else now.level_ratio,
    "km": lambda now: -1.0 if now.odometer_m is None else now.odometer_m,  # without an odometer: at the low end
    "fluid": lambda now: now.fluid or "",
    "type": vehicle_type,
    "last": lambda now: now.end_at.isoformat(),
})  # fmt: skip
SORTS: Final = (*ORDERS, *(f"-{name}" for name in ORDERS))


class VehiclesQuery(ListQuery, frozen=True, kw_only=True):
    """Filters and order of the list of vehicles; without ``sort`` the worst is first."""

    q: Annotated[str, Meta(max_length=64, pattern=NO_CONTROLS)] | None = None  # a part of the vehicle's name
    condition: Severity | None = None
    fluid: Annotated[str, Meta(max_length=200, pattern=NO_CONTROLS)] | None = None
    since: date | None = None  # first day (UTC) of the last event
    until: date | None = None
    calibration: Annotated[str, Meta(max_length=200, pattern=NO_CONTROLS)] | None = None  # version, or its type
    sort: Literal[SORTS] | None = None  # type: ignore[valid-type]
    only: Literal["due", "silent", "alarm", "untold"] | None = None
    tier: Annotated[int, Meta(ge=1, le=3)] | None = None  # what its signals suffice for


class VehicleQuery(Parameters, frozen=True, kw_only=True):
    """A vehicle, and the distance to its next service."""

    vehicle: Vehicle
    service_km: Annotated[int, Meta(ge=1, le=300_000)] = 15_000


class ShiftQuery(Parameters, frozen=True, kw_only=True):
    """An event: its vehicle, its stream (a run of a service, or a log) and its position there."""

    vehicle: Vehicle
    stream: Annotated[str, Meta(pattern="^[ -~]{1,128}$")]
    seq: Count


class AlarmsQuery(ListQuery, frozen=True, kw_only=True):
    """Filters of the list of alarms; without ``state`` the open ones."""

    state: Literal["open", "waiting", "all"] | None = None
    rule: AlarmRule | None = None


class Acknowledgement(Parameters, frozen=True, kw_only=True):
    """The form that acknowledges an alarm; clutch 0 is the vehicle as a whole."""

    vehicle: Vehicle
    clutch: Annotated[int, Meta(ge=0, le=2)]
    rule: AlarmRule
    number: Count
    note: Annotated[str, Meta(max_length=500)] | None = None


class NewFluid(Parameters, frozen=True, kw_only=True):
    """The form that notes new fluid, or takes a fill back that was noted by mistake."""

    vehicle: Vehicle
    product: Annotated[str, Meta(max_length=200)] | None = None
    at: Annotated[str, Meta(max_length=40)] | None = None
    odometer_km: Annotated[float, Meta(ge=0.0, le=5.0e6)] | None = None
    note: Annotated[str, Meta(max_length=500)] | None = None
    undo: Literal["yes"] | None = None
