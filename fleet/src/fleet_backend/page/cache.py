"""What was worked out once, kept for as long as what it was made of stays the same: readers look at the same few."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

ValueT = TypeVar("ValueT")
LONGEST_S: Final = 900.0  # a result that was replaced by another under its key is seen by then


class Same:
    """What it holds, compared by identity: for values that are large."""

    __slots__ = ("_held",)

    def __init__(self, held: object) -> None:
        self._held = held

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and other._held is self._held

    def __hash__(self) -> int:
        return id(self._held)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Kept(Generic[ValueT]):
    state: Hashable
    until_s: float
    size: int
    value: ValueT


class Cache(Generic[ValueT]):
    """Values by their keys, for many threads; those that nobody asked for longest are forgotten first.

    Parameters
    ----------
    most :
        Sizes of all values together; one is kept however large it is.
    size_of :
        How large a value is.
    """

    def __init__(
        self, most: int, size_of: Callable[[ValueT], int], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._most = most
        self._size_of = size_of
        self._clock = clock
        self._kept: OrderedDict[Hashable, _Kept[ValueT]] = OrderedDict()
        self._size = 0
        self._lock = threading.Lock()

    def of(self, key: Hashable, state: Hashable, make: Callable[[], ValueT]) -> ValueT:
        """Return what is kept under a key if it was made of the same state, or else make it."""
        now_s = self._clock()
        with self._lock:
            found = self._kept.get(key)
            if found is not None and found.state == state and now_s < found.until_s:
                self._kept.move_to_end(key)
                return found.value
        made = make()  # without the lock: two readers may do the same work, none waits for another's
        size = self._size_of(made)
        with self._lock:
            self._forget(key)
            self._kept[key] = _Kept(state=state, until_s=now_s + LONGEST_S, size=size, value=made)
            self._size += size
            while self._size > self._most and len(self._kept) > 1:
                self._forget(next(iter(self._kept)))
        return made

    def _forget(self, key: Hashable) -> None:
        gone = self._kept.pop(key, None)
        if gone is not None:
            self._size -= gone.size
