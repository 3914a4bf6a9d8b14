"""Times of a log: the unit that the load of its bus speaks for, where they jump, and which frames are in it twice."""

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from canlog.frames import EXTENDED_FLAG, FD_FLAG, MAX_GAP_NS, FrameBatch, join
from canlog.jit import array_kernel
from canlog.logs.columns.roles import MICROSECONDS, MILLISECONDS, SECONDS
from canlog.logs.frame_buffer import FrameRows, rows_of
from canlog.logs.log_counts import LogCounts

# Least bits of a frame (ISO 11898-1): no stuff bits, payload apart.
STANDARD_BITS, EXTENDED_BITS, BITS_PER_BYTE = 47, 67, 8
FASTEST_BIT_US = 1.0  # 1 Mbit/s
FASTEST_FD_BIT_US = 0.125  # 8 Mbit/s, of the payload of a CAN FD frame
MOST_LOAD_RATIO = 2.0  # adapters that stamp frames by the packet may show more than one for a moment
LEAST_FRAMES = 10
UNIT_NAMES = {MICROSECONDS: "microseconds", MILLISECONDS: "milliseconds", SECONDS: "seconds"}


def bus_load_ratio(batch: FrameBatch) -> float:
    """Return the least load of the busiest channel at the fastest bit rates; infinite where time stands still.

    0 for a channel with too few frames to tell.
    """
    return max((_load_ratio(batch[batch.channel == channel]) for channel in np.unique(batch.channel)), default=0.0)


def is_plausible(load_ratio: float) -> bool:
    """Return whether a bus can have such a load."""
    return load_ratio <= MOST_LOAD_RATIO


def likely_unit(batch: FrameBatch) -> tuple[int, list[str]]:
    """Return the unit of times that were read as microseconds, and what is to be said of it.

    The finest unit with which the load is plausible; where it is with none, they stay microseconds.
    """
    load_ratio = bus_load_ratio(batch)
    for unit in (MICROSECONDS, MILLISECONDS, SECONDS):
        if is_plausible(load_ratio / 10**unit):
            if unit == MICROSECONDS:
                return unit, []
            note = (
                f"times are taken as {UNIT_NAMES[unit]}, not microseconds: a bus of 1 Mbit/s would have a load of "
                f"{100 * load_ratio:.0f} %"
            )
            return unit, [note]
    return MICROSECONDS, []


def _load_ratio(batch: FrameBatch) -> float:
    if len(batch) < LEAST_FRAMES:
        return 0.0
    span_us = float(batch.t_ns.max() - batch.t_ns.min()) / 1e3
    busy_us = float(_least_us(batch)[1:].sum())
    return busy_us / span_us if span_us else float("inf")


def _least_us(batch: FrameBatch) -> FloatArray:
    overhead = np.where(batch.can_id & np.uint32(EXTENDED_FLAG), EXTENDED_BITS, STANDARD_BITS) * FASTEST_BIT_US
    is_fd = (batch.flags & np.uint8(FD_FLAG)) != 0
    bit_us = np.where(is_fd, FASTEST_FD_BIT_US, FASTEST_BIT_US)
    least_us: FloatArray = np.where(is_fd, STANDARD_BITS / 2.0, overhead) + BITS_PER_BYTE * bit_us * batch.length
    return least_us


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
