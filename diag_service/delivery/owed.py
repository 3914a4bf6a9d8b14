"""Which results a backend owes a receipt for, which of them went astray, and how far behind it is."""

from collections.abc import Iterable
from itertools import islice


class Owed:
    """Results that were sent and not acknowledged, by position; times are those of the event loop [s].

    A receipt for a younger result says of an older one that the backend is not behind: a worker or a broker died with
    it. It is sent again at once instead of when its time is over; only once, since workers may differ in speed.

    Parameters
    ----------
    astray_after_s :
        What was sent so long before an acknowledged one was lost on its way, not delayed.
    """

    def __init__(self, astray_after_s: float) -> None:
        self._astray_after_s = astray_after_s
        self._sent_s: dict[int, float] = {}  # the longest owed first
        self._heard_s = float("-inf")  # when the youngest acknowledged result was sent
        self._hurried: set[int] = set()  # were sent again before their time

    def __len__(self) -> int:
        """Return how many receipts are outstanding."""
        return len(self._sent_s)

    def send(self, positions: Iterable[int], now_s: float) -> None:
        """Note that results were sent."""
        self._sent_s.update(dict.fromkeys(positions, now_s))

    def hear(self, positions: Iterable[int]) -> None:
        """Note that results were acknowledged."""
        for position in positions:
            self._heard_s = max(self._heard_s, self._sent_s.pop(position, self._heard_s))
            self._hurried.discard(position)

    def take_astray(self) -> list[int]:
        """Take out what must have been lost on its way."""
        limit_s = self._heard_s - self._astray_after_s
        astray = [position for position in self._sent_until(limit_s) if position not in self._hurried]
        self._hurried.update(astray)
        return self._forget(astray)

    def take_sent_until(self, limit_s: float) -> list[int]:
        """Take out what was sent until a moment."""
        return self._forget(self._sent_until(limit_s))

    def take_oldest(self, count: int) -> list[int]:
        """Take out some of what has waited longest."""
        return self._forget(list(islice(self._sent_s, count)))

    def lag_s(self, now_s: float) -> float:
        """Return how long the backend has had the oldest result that is younger than all it acknowledged."""
        return now_s - next((sent_s for sent_s in self._sent_s.values() if sent_s > self._heard_s), now_s)

    def oldest_s(self) -> float | None:
        """Return when the result was sent that has waited longest; None: nothing is owed."""
        return next(iter(self._sent_s.values()), None)

    def _sent_until(self, limit_s: float) -> list[int]:
        found = []
        for position, sent_s in self._sent_s.items():
            if sent_s > limit_s:
                break
            found.append(position)
        return found

    def _forget(self, positions: list[int]) -> list[int]:
        for position in positions:
            del self._sent_s[position]
        return positions
