"""Where the time of a log jumps, and which frames are in it twice."""

import numpy as np

from canlog.arrays import Int64Array
from canlog.frames import MAX_GAP_NS, FrameBatch, join
from canlog.jit import array_kernel
from canlog.logs.frame_buffer import FrameRows, rows_of
from canlog.logs.log_counts import LogCounts

NS_PER_S = 1e9

# What the steps from frame to frame come to.
BACK, AHEAD, FIRST_JUMP, REPEATED, STEP_FIELDS = range(5)


class TimeWatch:
    """Counts jumps of time and repeated frames; what it finds does not depend on how the log was cut."""

    def __init__(self, counts: LogCounts) -> None:
        self._counts = counts
        self._last: FrameBatch | None = None
        self._seen = 0

    def look(self, batch: FrameBatch) -> None:
        if self._last is not None and not 0 < int(batch.t_ns[0]) - int(self._last.t_ns[0]) <= MAX_GAP_NS:
            self._look_inside(join([self._last, batch[:1]]), self._seen)
        self._look_inside(batch, self._seen + 1)
        self._last = batch[-1:]
        self._seen += len(batch)

    def _look_inside(self, batch: FrameBatch, number: int) -> None:
        counts, steps = self._counts, np.zeros(STEP_FIELDS, np.int64)
        look_at_steps(rows_of(batch), steps)
        row = int(steps[FIRST_JUMP])
        if row and not counts.first_jump:
            step_s = int(batch.t_ns[row] - batch.t_ns[row - 1]) / NS_PER_S
            counts.first_jump = f"frame {number + row}: time jumps by {step_s:+.6f} s"
        counts.jumps_back += int(steps[BACK])
        counts.jumps_ahead += int(steps[AHEAD])
        counts.repeated += int(steps[REPEATED])


@array_kernel
def look_at_steps(rows: FrameRows, steps: Int64Array) -> None:
    """Count the frames before the one before them, far behind it, and equal to it; note the row of the first jump."""
    for row in range(1, rows.t_ns.size):
        step_ns = rows.t_ns[row] - rows.t_ns[row - 1]
        if step_ns == 0:
            steps[REPEATED] += _is_repeated(rows, row)
        elif step_ns < 0 or step_ns > MAX_GAP_NS:
            if steps[FIRST_JUMP] == 0:
                steps[FIRST_JUMP] = row
            steps[BACK if step_ns < 0 else AHEAD] += 1


@array_kernel
def _is_repeated(rows: FrameRows, row: int) -> bool:
    for word in range(rows.words.shape[1]):
        if rows.words[row, word] != rows.words[row - 1, word]:
            return False
    is_same: bool = rows.can_id[row] == rows.can_id[row - 1] and rows.length[row] == rows.length[row - 1]
    is_same = is_same and rows.flags[row] == rows.flags[row - 1]
    return is_same and bool(rows.channel[row] == rows.channel[row - 1])
