"""Lists part by part: which clutches of the fleet a reader asks for, the worst first; what came, the latest first."""

import base64
import binascii
import json
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final, TypeVar

from sqlalchemy import Select, Table, and_, or_, select

from fleet_backend.errors import NotFoundError
from fleet_backend.page.calibrations import type_of
from fleet_backend.page.records import ClutchNow, Severity

Place = tuple[int, float, float, str, int]  # sorts as the view fleet_worst_first does
_PLACE: Final = (int, float, float, str, int)
RowT = TypeVar("RowT")
SEVERITY: Final = {Severity.CHANGE_FLUID: 0, Severity.WATCH: 1, Severity.GOOD: 2, Severity.NO_VERDICT: 3}
_NO_LEVEL: Final = 9.0  # of the view
_MOST: Final = 2**53  # beyond it a float is not exact
_NO_PLACE: Final = "after: not a position in a list; use `next` of the list before"


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """What a reader looks for; what is None may be anything."""

    name_part: str | None = None
    condition: str | None = None
    fluid: str | None = None
    calibration: str | None = None  # its version, or the type that it describes


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """Some of the clutches that were asked for."""

    clutches: tuple[ClutchNow, ...]
    matching_count: int
    next: str | None


def place_of(now: ClutchNow) -> Place:
    """Return where a clutch stands in the fleet: the smaller the worse."""
    severity = SEVERITY.get(Severity(now.condition), len(SEVERITY))
    falling = now.probability_negative_slope or 0.0
    return severity, -falling, now.level_ratio or _NO_LEVEL, now.vehicle, now.clutch


def worst_first(clutches: Iterable[ClutchNow]) -> tuple[ClutchNow, ...]:
    """Return clutches as the fleet's page shows them."""
    return tuple(sorted(clutches, key=place_of))


def matching(clutches: Sequence[ClutchNow], wanted: Wanted) -> list[ClutchNow]:
    """Return the clutches that are looked for, in the order in which they come."""
    found = list(clutches)
    if wanted.name_part:
        part = wanted.name_part.casefold()
        found = [now for now in found if part in now.vehicle.casefold()]
    if wanted.condition is not None:
        found = [now for now in found if now.condition == wanted.condition]
    if wanted.fluid is not None:
        found = [now for now in found if now.fluid == wanted.fluid]
    if wanted.calibration is not None:
        found = [now for now in found if wanted.calibration in {now.calibration_version, vehicle_type(now)}]
    return found


def part_of(found: Sequence[ClutchNow], after: str | None, limit: int) -> Part:
    """Return the next clutches behind the one that ``after`` names, which need not be there any more.

    Raises
    ------
    NotFoundError
        If ``after`` is nothing that an earlier part named.
    """
    first = 0 if after is None else bisect_right(found, tuple(read_words(after, _PLACE)), key=place_of)
    some, following = page_of(found[first : first + limit + 1], limit, place_of)
    return Part(clutches=some, matching_count=len(found), next=following)


def page_of(
    found: Sequence[RowT], limit: int, place: Callable[[RowT], Sequence[object]]
) -> tuple[tuple[RowT, ...], str | None]:
    """Return the first rows, ``limit`` at most, and the word that names the place of the last if more are behind it."""
    some = tuple(found[:limit])
    return some, cursor(place(some[-1])) if len(found) > limit else None


def cursor(place: Sequence[object]) -> str:
    """Return a place as a word of an address."""
    return base64.urlsafe_b64encode(json.dumps(place).encode()).decode().rstrip("=")


def read_words(word: str, kinds: Sequence[type]) -> list[object]:
    """Return the values in a word that ``cursor`` made; raises NotFoundError if they are not of these kinds."""
    values = _decoded(word)
    if isinstance(values, list) and len(values) == len(kinds):
        # JSON has one kind of number: a float without fraction may come back as a whole number.
        made = [
            float(one) if kind is float and type(one) is int and abs(one) < _MOST else one
            for kind, one in zip(kinds, values, strict=True)
        ]
        if all(type(one) is kind for kind, one in zip(kinds, made, strict=True)):
            return made
    raise NotFoundError(_NO_PLACE)


def _decoded(word: str) -> object:
    try:
        return json.loads(base64.urlsafe_b64decode(word + "=" * (-len(word) % 4)))
    except (binascii.Error, ValueError, RecursionError):
        return None


def vehicle_type(now: ClutchNow) -> str:
    return type_of(now.vehicle, now.calibration_version)


def latest_first(table: Table, time: str, key: Sequence[str], after: str | None, limit: int) -> Select[Any]:
    """Return the statement for the next rows, the latest first, and one more; a key tells apart what came at a time.

    Raises
    ------
    NotFoundError
        If ``after`` is nothing that an earlier part named: the time of its last row, and the values of its key.
    """
    at, columns = table.c[time], [table.c[name] for name in key]
    statement = select(table).order_by(at.desc(), *columns).limit(limit + 1)
    if after is None:
        return statement
    moment, *values = read_words(after, (str, *(column.type.python_type for column in columns)))
    try:
        last_at = datetime.fromisoformat(str(moment)).astimezone(UTC)
    except (ValueError, OverflowError) as exc:
        raise NotFoundError(_NO_PLACE) from exc
    pairs = list(zip(columns, values, strict=True))
    # The first column that differs tells.
    behind = (
        and_(*(one == value for one, value in pairs[:place]), column > last)
        for place, (column, last) in enumerate(pairs)
    )
    return statement.where(at <= last_at, or_(at < last_at, *behind))
