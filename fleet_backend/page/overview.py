"""The vehicles of the fleet, one row each, in the order that a reader asks for, part by part: pure."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

from fleet_backend.page.listing import Wanted, cursor, matching, place_of, read_words
from fleet_backend.page.records import ClutchNow, Severity, VehiclesAnswer

ORDERS: Final[Mapping[str, Callable[[ClutchNow], Any]]] = MappingProxyType({
    "vehicle": lambda one: one.vehicle,
    "level": lambda one: 9.0 if one.level_ratio is None else one.level_ratio,
    "km": lambda one: -1.0 if one.odometer_m is None else one.odometer_m,  # who has no odometer is at the low end
    "fluid": lambda one: one.fluid or "",
    "type": lambda one: one.calibration_version,
    "last": lambda one: one.end_at.isoformat(),
})  # fmt: skip
SORTS: Final = (*ORDERS, *(f"-{name}" for name in ORDERS))


def vehicles_of(clutches: Mapping[str, Sequence[ClutchNow]]) -> tuple[ClutchNow, ...]:
    """Return the worse clutch of each vehicle, the worst first; distance, fluid and last event are the vehicle's."""
    return tuple(sorted(map(_vehicle, clutches.values()), key=place_of))


def _vehicle(clutches: Sequence[ClutchNow]) -> ClutchNow:
    worst, last = min(clutches, key=place_of), max(clutches, key=lambda one: one.end_at)
    furthest_m = max((one.odometer_m for one in clutches if one.odometer_m is not None), default=None)
    return replace(worst, odometer_m=furthest_m, fluid=last.fluid, end_at=last.end_at)


def answer_of(
    vehicles: Sequence[ClutchNow], wanted: Wanted, sort: str | None, after: str | None, limit: int
) -> VehiclesAnswer:
    """Return the next vehicles behind the one that ``after`` names, and how many of all have each verdict.

    Raises
    ------
    NotFoundError
        If ``after`` is nothing that an earlier part in this order named.
    """
    found = matching(vehicles, wanted)
    of = None if sort is None else ORDERS[sort.removeprefix("-")]
    key: Callable[[ClutchNow], Any] = place_of if of is None else lambda one: (of(one), one.vehicle)
    is_down = sort is not None and sort.startswith("-")
    rest = found if of is None else sorted(found, key=key)
    if after is not None and rest:
        place = tuple(read_words(after, [type(value) for value in key(rest[0])]))
        rest = [one for one in rest if key(one) < place] if is_down else rest[bisect_right(rest, place, key=key) :]
    ordered = rest[::-1] if is_down else rest
    counts = Counter(one.condition for one in vehicles)
    return VehiclesAnswer(
        vehicles=tuple(ordered[:limit]),
        matching_count=len(found),
        vehicle_count=len(vehicles),
        counts={one.value: counts[one.value] for one in Severity},
        next=cursor(key(ordered[limit - 1])) if len(ordered) > limit else None,
    )
