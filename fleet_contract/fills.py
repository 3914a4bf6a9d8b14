"""What vehicle and fleet hold alike of fluid fills: when two of them are one, and which odometer cannot be right."""

from collections.abc import Callable, Iterable
from datetime import datetime, timedelta
from typing import Final, TypeVar

SAME_WITHIN: Final = timedelta(days=1)  # nobody changes the fluid twice a day, but two people may note it
FARTHEST_M: Final = 2.0e7  # that a vehicle drives unheard of between its last result and a fill
READING_M: Final = 1.0e4  # by which two readings of one moment may differ
HIGHEST_M: Final = 5.0e9  # no car has driven farther
INSIST: Final = "--insist notes it all the same, as after a change of the instrument cluster"
FillT = TypeVar("FillT")


def distinct(fills: Iterable[FillT], moment: Callable[[FillT], datetime]) -> list[FillT]:
    """Return fills, the earliest first, without those that were noted within a day of the one before them."""
    found: list[FillT] = []
    for fill in sorted(fills, key=moment):
        if not found or moment(fill) - moment(found[-1]) >= SAME_WITHIN:
            found.append(fill)
    return found


def odometer_complaint(odometer_m: float | None, before_m: float | None, after_m: float | None) -> str:
    """Return why a fill cannot have this odometer, by the readings before and after it; empty if it can."""
    if odometer_m is None:
        return ""
    said = f"the odometer cannot read {_km(odometer_m)}"
    if odometer_m > HIGHEST_M:
        return f"{said}: no car has driven that far"
    if after_m is not None and odometer_m > after_m + READING_M:
        return f"{said}: after that it read {_km(after_m)}; {INSIST}"
    if before_m is not None and not -READING_M <= odometer_m - before_m <= FARTHEST_M:
        return f"{said}: it read {_km(before_m)} before; {INSIST}"
    return ""


def _km(distance_m: float) -> str:
    return f"{distance_m / 1000.0:,.0f} km"
