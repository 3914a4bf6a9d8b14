"""Where the time of a log jumps, and which frames are in it twice."""

import numpy as np

from diag_service.frames import MAX_GAP_NS, FrameBatch
from diag_service.sources.tally import Tally

NS_PER_S = 1e9


class TimeWatch:
    """Counts jumps of time and repeated frames into a tally; what it finds does not depend on how the log was cut."""

    def __init__(self, tally: Tally) -> None:
        self._tally = tally
        self._last: FrameBatch | None = None
        self._seen = 0

    def look(self, batch: FrameBatch) -> None:
        """Look at the next frames."""
        before = batch[:1] if self._last is None else self._last
        steps_ns = np.diff(batch.t_ns, prepend=before.t_ns[0])
        back, ahead = np.flatnonzero(steps_ns < 0), np.flatnonzero(steps_ns > MAX_GAP_NS)
        if len(back) or len(ahead):
            first = int(min(*back[:1], *ahead[:1])) if len(back) and len(ahead) else int([*back, *ahead][0])
            place = f"frame {self._seen + first + 1}: time jumps by {steps_ns[first] / NS_PER_S:+.6f} s"
            self._tally.jump(len(back), len(ahead), place)
        self._count_repeated(before, batch, np.flatnonzero(steps_ns == 0))
        self._last = batch[-1:]
        self._seen += len(batch)

    def _count_repeated(self, before: FrameBatch, batch: FrameBatch, rows: np.ndarray[tuple[int], np.dtype[np.intp]]) -> None:
        """Count frames that equal the one before them, time and all; ``rows`` have its time."""
        if not self._seen:
            rows = rows[rows > 0]
        rows = rows[batch.can_id[rows] == np.where(rows > 0, batch.can_id[rows - 1], before.can_id[0])]
        for row in rows.tolist():
            other, place = (batch, row - 1) if row else (before, 0)
            is_same = batch.length[row] == other.length[place] and batch.channel[row] == other.channel[place]
            length = int(batch.length[row])
            same_data = np.array_equal(batch.data[row, :length], other.data[place, :length])
            self._tally.repeated += bool(is_same and same_data)
