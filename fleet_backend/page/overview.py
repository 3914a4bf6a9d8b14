"""The vehicles of the fleet, one row each, in the order that a reader asks for, part by part: pure."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

from fleet_backend.page.listing import Wanted, cursor, matching, place_of, read_words
from fleet_backend.page.records import ClutchNow, Severity, VehicleNow, VehiclesAnswer

Key = Callable[[VehicleNow], Any]
_UNKNOWN_M: Final = -1.0  # vehicles without an odometer stand at the low end
ORDERS: Final[Mapping[str, tuple[type, Key]]] = MappingProxyType({
    "vehicle": (str, lambda one: one.vehicle),
    "level": (float, lambda one: 9.0 if one.level_ratio is None else one.level_ratio),
    "km": (float, lambda one: _UNKNOWN_M if one.odometer_m is None else one.odometer_m),
    "fluid": (str, lambda one: one.fluid or ""),
    "type": (str, lambda one: one.calibration_version),
    "last": (str, lambda one: one.end_at.isoformat()),
})  # fmt: skip
SORTS: Final = (*ORDERS, *(f"-{name}" for name in ORDERS))


def vehicle_now(clutches: Sequence[ClutchNow]) -> VehicleNow:
    """Return a vehicle as its worse clutch is; how far it went and when it was heard of, by all of them."""
    worst, last = min(clutches, key=place_of), max(clutches, key=lambda one: one.end_at)
    return VehicleNow(
        vehicle=worst.vehicle,
        clutch=worst.clutch,
        condition=worst.condition,
        condition_reason=worst.condition_reason,
        advice=worst.advice,
        level_ratio=worst.level_ratio,
        probability_negative_slope=worst.probability_negative_slope,
        odometer_m=max((one.odometer_m for one in clutches if one.odometer_m is not None), default=None),
        fluid=last.fluid,
        calibration_version=last.calibration_version,
        end_at=last.end_at,
    )


def counts_of(vehicles: Sequence[VehicleNow]) -> Mapping[str, int]:
    """Return how many vehicles have each verdict, the worst verdict first."""
    found = Counter(one.condition for one in vehicles)
    return {one.value: found[one.value] for one in Severity}


def vehicles_of(clutches: Mapping[str, Sequence[ClutchNow]]) -> tuple[VehicleNow, ...]:
    """Return the vehicles with these clutches, the worst first."""
    return tuple(sorted(map(vehicle_now, clutches.values()), key=place_of))


def vehicles_part(
    found: Sequence[VehicleNow], sort: str | None, after: str | None, limit: int
) -> tuple[tuple[VehicleNow, ...], str | None]:
    """Return the next vehicles behind the place that ``after`` names, and the place behind them if there are more.

    Raises
    ------
    NotFoundError
        If ``after`` is nothing that an earlier part in this order named.
    """
    kinds: tuple[type, ...] = (int, float, float, str, int)
    key: Key = place_of
    if sort is not None:
        kind, value_of = ORDERS[sort.removeprefix("-")]
        kinds, key = (kind, str), lambda one: (value_of(one), one.vehicle)
    is_down = sort is not None and sort.startswith("-")
    rising = found if sort is None else sorted(found, key=key)
    if after is None:
        rest = rising
    else:
        place = tuple(read_words(after, kinds))
        rest = (
            [one for one in rising if key(one) < place] if is_down else rising[bisect_right(rising, place, key=key) :]
        )
    ordered = rest[::-1] if is_down else rest
    some = tuple(ordered[:limit])
    return some, cursor(key(some[-1])) if len(ordered) > limit else None


def answer_of(
    vehicles: Sequence[VehicleNow], wanted: Wanted, sort: str | None, after: str | None, limit: int
) -> VehiclesAnswer:
    """Return a part of the vehicles, which come worst first, and how many of all have each verdict."""
    found = matching(vehicles, wanted)
    some, following = vehicles_part(found, sort, after, limit)
    return VehiclesAnswer(
        vehicles=some,
        matching_count=len(found),
        vehicle_count=len(vehicles),
        counts=counts_of(vehicles),
        next=following,
    )
