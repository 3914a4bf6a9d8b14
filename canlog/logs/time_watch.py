"""Where the time of a log jumps, and which frames are in it twice."""

import numpy as np
import numpy.typing as npt

from canlog.arrays import Int64Array
from canlog.frame_columns import join
from canlog.frames import MAX_GAP_NS, FrameBatch
from canlog.jit import array_kernel
from canlog.logs.tally import Tally

NS_PER_S = 1e9

BoolArray = npt.NDArray[np.bool_]


# What the steps of time in a batch come to.
BACK, AHEAD, FIRST_JUMP, SAME, STEP_FIELDS = range(5)


class TimeWatch:
    """Counts jumps of time and repeated frames into a tally; what it finds does not depend on how the log was cut."""

    def __init__(self, tally: Tally) -> None:
        self._tally = tally
        self._last: FrameBatch | None = None
        self._seen = 0

    def look(self, batch: FrameBatch) -> None:
        """Look at the next frames."""
        before = batch[:1] if self._last is None else self._last
        before_ns = int(before.t_ns[0])
        steps = np.zeros(STEP_FIELDS, np.int64)
        look_at_steps(np.require(batch.t_ns, np.int64, ("C", "W")), before_ns, steps)
        if steps[BACK] or steps[AHEAD]:
            first = int(steps[FIRST_JUMP])
            step_ns = int(batch.t_ns[first]) - (int(batch.t_ns[first - 1]) if first else before_ns)
            place = f"frame {self._seen + first + 1}: time jumps by {step_ns / NS_PER_S:+.6f} s"
            self._tally.jump(int(steps[BACK]), int(steps[AHEAD]), place)
        if steps[SAME]:
            self._count_repeated(before, batch)
        self._last = batch[-1:]
        self._seen += len(batch)

    def _count_repeated(self, before: FrameBatch, batch: FrameBatch) -> None:
        """Count frames that equal the one before them, time and all."""
        if self._seen and batch.t_ns[0] == before.t_ns[0]:
            joined = join([before, batch[:1]])
            self._tally.repeated += int(_equals_the_one_before(joined, np.array([1])).sum())
        has_same_time = batch.t_ns[1:] == batch.t_ns[:-1]
        rows = 1 + np.flatnonzero(has_same_time & (batch.can_id[1:] == batch.can_id[:-1]))
        self._tally.repeated += int(_equals_the_one_before(batch, rows).sum())


@array_kernel
def look_at_steps(t_ns: Int64Array, before_ns: int, steps: Int64Array) -> None:
    """Count the times that lie before the one before them, far behind it, and at it; note the first jump."""
    for row in range(t_ns.size):
        step_ns = t_ns[row] - before_ns
        before_ns = t_ns[row]
        steps[SAME] += step_ns == 0
        if 0 <= step_ns <= MAX_GAP_NS:
            continue
        if steps[BACK] + steps[AHEAD] == 0:
            steps[FIRST_JUMP] = row
        steps[BACK] += step_ns < 0
        steps[AHEAD] += step_ns > 0


def _equals_the_one_before(batch: FrameBatch, rows: Int64Array) -> BoolArray:
    equal: BoolArray = (batch.data[rows] == batch.data[rows - 1]).all(axis=1)
    for column in (batch.can_id, batch.length, batch.flags, batch.channel):
        equal = equal & (column[rows] == column[rows - 1])
    return equal
