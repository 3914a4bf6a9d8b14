"""Lists part by part: a place in the order of a list, as a word of an address."""

import base64
import binascii
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from typing import Any, Final, TypeVar

import msgspec

from fleet_backend.errors import NotFoundError

RowT = TypeVar("RowT")
Place = Sequence[Any]
NO_PLACE: Final = "after: not a position in a list; use `next` of the list before"


def word_of(place: Place | None) -> str | None:
    """Return a place as a word of an address."""
    return None if place is None else base64.urlsafe_b64encode(msgspec.json.encode(place)).decode().rstrip("=")


def read_place(word: str, kinds: Sequence[type]) -> Any:  # noqa: ANN401 - a tuple of these kinds
    """Return the place in a word that ``word_of`` made; raises NotFoundError if it is not of these kinds."""
    try:
        content = base64.urlsafe_b64decode(word + "=" * (-len(word) % 4))
        return msgspec.json.decode(content, type=tuple.__class_getitem__(tuple(kinds)))
    except (binascii.Error, ValueError, RecursionError) as exc:
        raise NotFoundError(NO_PLACE) from exc


def part_of(
    found: Sequence[RowT],
    place: Callable[[RowT], tuple[Any, ...]],
    after: str | None,
    limit: int,
    *,
    is_down: bool = False,
) -> tuple[tuple[RowT, ...], str | None]:
    """Return the next rows of a list behind the one that ``after`` names, and the word for the part behind them.

    The list is in the order of its places; ``is_down``: it is read from its end. The row that is named need not be
    there any more.

    Raises
    ------
    NotFoundError
        If ``after`` is nothing that an earlier part named.
    """
    if after is not None and found:
        last = read_place(after, [type(value) for value in place(found[0])])
        found = (
            found[: bisect_left(found, last, key=place)] if is_down else found[bisect_right(found, last, key=place) :]
        )
    some = tuple(found[::-1][:limit] if is_down else found[:limit])
    return some, word_of(place(some[-1])) if len(found) > limit else None
