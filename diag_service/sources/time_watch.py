"""Where the time of a log jumps, and which frames are in it twice."""

import numpy as np
import numpy.typing as npt

from diag_service.frames import MAX_GAP_NS, FrameBatch
from diag_service.records import Int64Array
from diag_service.sources.columns import join
from diag_service.sources.tally import Tally

NS_PER_S = 1e9

BoolArray = npt.NDArray[np.bool_]


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
        jumps = np.flatnonzero((steps_ns < 0) | (steps_ns > MAX_GAP_NS))
        if len(jumps):
            first, back = int(jumps[0]), int(np.count_nonzero(steps_ns[jumps] < 0))
            place = f"frame {self._seen + first + 1}: time jumps by {steps_ns[first] / NS_PER_S:+.6f} s"
            self._tally.jump(back, len(jumps) - back, place)
        self._count_repeated(before, batch, steps_ns == 0)
        self._last = batch[-1:]
        self._seen += len(batch)

    def _count_repeated(self, before: FrameBatch, batch: FrameBatch, has_same_time: BoolArray) -> None:
        """Count frames that equal the one before them, time and all."""
        if self._seen and has_same_time[0]:
            joined = join([before, batch[:1]])
            self._tally.repeated += int(_equals_the_one_before(joined, np.array([1])).sum())
        rows = 1 + np.flatnonzero(has_same_time[1:] & (batch.can_id[1:] == batch.can_id[:-1]))
        self._tally.repeated += int(_equals_the_one_before(batch, rows).sum())


def _equals_the_one_before(batch: FrameBatch, rows: Int64Array) -> BoolArray:
    equal: BoolArray = (batch.data[rows] == batch.data[rows - 1]).all(axis=1)
    for column in (batch.can_id, batch.length, batch.flags, batch.channel):
        equal = equal & (column[rows] == column[rows - 1])
    return equal
