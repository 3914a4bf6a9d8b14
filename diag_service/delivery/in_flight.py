"""Results in flight, sent and without a receipt: which of them were lost, and how far behind the backend is."""

from collections.abc import Iterable
from itertools import islice, takewhile


class InFlight:
    """Results that were sent and not acknowledged, by position; times are those of the event loop [s].

    A receipt for a younger result says of an older one that the backend is not behind: a worker or a broker died with
    it. It is sent again at once instead of when its time is over; only once, since workers may differ in speed.
    """

    def __init__(self, astray_after_s: float) -> None:
        self._astray_after_s = astray_after_s  # before an acknowledged one: lost on its way, not delayed
        self._sent_s: dict[int, float] = {}  # the longest in flight first
        self._landed_s = float("-inf")  # when the youngest acknowledged result was sent
        self._hurried: set[int] = set()  # were sent again before their time

    def __len__(self) -> int:
        """Return how many receipts are outstanding."""
        return len(self._sent_s)

    def add(self, positions: Iterable[int], now_s: float) -> None:
        """Note that results were sent."""
        self._sent_s.update(dict.fromkeys(positions, now_s))

    def acknowledge(self, positions: Iterable[int]) -> None:
        """Note that results arrived."""
        for position in positions:
            self._landed_s = max(self._landed_s, self._sent_s.pop(position, self._landed_s))
            self._hurried.discard(position)

    def pop_astray(self) -> list[int]:
        """Remove and return what must have been lost on its way."""
        limit_s = self._landed_s - self._astray_after_s
        astray = [position for position in self._sent_until(limit_s) if position not in self._hurried]
        self._hurried.update(astray)
        return self._pop(astray)

    def pop_sent_until(self, limit_s: float) -> list[int]:
        """Remove and return what was sent until a moment."""
        return self._pop(self._sent_until(limit_s))

    def pop_oldest(self, count: int) -> list[int]:
        """Remove and return some of what has waited longest."""
        return self._pop(list(islice(self._sent_s, count)))

    def lag_s(self, now_s: float) -> float:
        """Return how long the backend has had the oldest result that is younger than all it acknowledged."""
        return now_s - next((sent_s for sent_s in self._sent_s.values() if sent_s > self._landed_s), now_s)

    def oldest_s(self) -> float | None:
        """Return when the result was sent that has waited longest; None: nothing is in flight."""
        return next(iter(self._sent_s.values()), None)

    def _sent_until(self, limit_s: float) -> list[int]:
        return list(takewhile(lambda position: self._sent_s[position] <= limit_s, self._sent_s))

    def _pop(self, positions: list[int]) -> list[int]:
        for position in positions:
            del self._sent_s[position]
        return positions
