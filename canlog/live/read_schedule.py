"""How long frames may gather before they are looked at: every wake-up costs many times what a frame costs."""

from collections.abc import Callable
from typing import Final

NS_PER_S: Final = 1_000_000_000
RELAXED_S: Final = 0.5  # 2,200 frames of a full bus of 500 kbit/s, a quarter of what the receive buffer holds
EXPECTING_S: Final = 0.1  # no longer than what a shift needs after its end: its end is known before that is over
URGENT_S: Final = 0.01
LATE_S: Final = 0.002  # frames of the moment that is waited for must have arrived

Listener = Callable[[], None]


class ReadSchedule:
    """What a source and its consumer agree on: the consumer tells what it waits for.

    Nothing hurries while nothing can come of it. Once it is known at which bus time a result will be there, the
    frames are looked at just then.
    """

    def __init__(self) -> None:
        self._is_expecting = False
        self._due_ns: int | None = None
        self.on_change: Listener = lambda: None  # the source's, to think again about a time it has set

    def wait_for(self, *, is_expecting: bool, due_ns: int | None) -> None:
        """Tell what is waited for.

        Parameters
        ----------
        is_expecting
            Whether a shift has begun.
        due_ns
            Bus time beyond which the next shift is known in full, if it has ended.
        """
        if (is_expecting, due_ns) != (self._is_expecting, self._due_ns):
            self._is_expecting, self._due_ns = is_expecting, due_ns
            self.on_change()

    def gather_s(self, seen_ns: int | None) -> float:
        """For how long frames may gather that come after bus time ``seen_ns`` [s]."""
        longest_s = EXPECTING_S if self._is_expecting else RELAXED_S
        if self._due_ns is None or seen_ns is None:
            return longest_s
        return min(max((self._due_ns - seen_ns) / NS_PER_S + LATE_S, URGENT_S), longest_s)
