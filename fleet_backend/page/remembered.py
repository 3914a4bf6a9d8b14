"""What was worked out of a clutch's past, kept for as long as nothing new is stored: readers look at the same few."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Final

from fleet_backend.page.records import OutlookAnswer, TrendPoint

MOST_POINTS: Final = 60_000  # of trends that are kept, a kilobyte each
LONGEST_S: Final = 900.0  # a result that was replaced by another under its key is seen by then


@dataclass(frozen=True, slots=True, kw_only=True)
class Past:
    """The past of a clutch, and what follows from it."""

    trend: tuple[TrendPoint, ...]
    outlook: OutlookAnswer | None
    why_no_outlook: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Kept:
    state: Hashable
    until_s: float
    past: Past


class Remembered:
    """Pasts by their keys, for many threads; those that nobody asked for longest are forgotten first."""

    def __init__(self, most_points: int = MOST_POINTS, clock: Callable[[], float] = time.monotonic) -> None:
        self._most_points = most_points
        self._clock = clock
        self._kept: OrderedDict[Hashable, _Kept] = OrderedDict()
        self._points = 0
        self._lock = threading.Lock()

    def past(self, key: Hashable, state: Hashable, make: Callable[[], Past]) -> Past:
        """Return what is kept under a key if it was made of the same state, or else make it."""
        now_s = self._clock()
        with self._lock:
            found = self._kept.get(key)
            if found is not None and found.state == state and now_s < found.until_s:
                self._kept.move_to_end(key)
                return found.past
        made = make()  # without the lock: two readers may do the same work, none waits for another's
        with self._lock:
            self._forget(key)
            self._kept[key] = _Kept(state=state, until_s=now_s + LONGEST_S, past=made)
            self._points += len(made.trend)
            while self._points > self._most_points and len(self._kept) > 1:
                self._forget(next(iter(self._kept)))
        return made

    def _forget(self, key: Hashable) -> None:
        gone = self._kept.pop(key, None)
        if gone is not None:
            self._points -= len(gone.past.trend)
