"""Frames in the order of their times: what stands a little later than its time is put where it belongs.

Two channels that are merged, two senders, or a recorder with several threads leave lines that are some microseconds or
milliseconds late. A step back that is longer than ``LATE_NS`` is another recording, and stays where it is.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, Int64Array
from canlog.frames import FrameBatch, empty_batch, join
from canlog.jit import kernel

LATE_NS: Final = 100_000_000  # ten cycles of a quick message: no recorder that works holds a frame back for longer
HELD_FRAMES: Final = 65_536  # three times what ten full buses of 1 Mbit/s carry in that time


@kernel
def find_late(t_ns: Int64Array, late_ns: Int64Array, begins: BoolArray) -> None:
    """Fill in how late each frame is [ns], and where another recording begins; shape (n,) each, n >= 1."""
    latest_ns = t_ns[0]
    for row in range(t_ns.size):
        behind_ns = latest_ns - t_ns[row]
        begins[row] = behind_ns > LATE_NS
        if behind_ns <= 0 or begins[row]:
            latest_ns, behind_ns = t_ns[row], 0
        late_ns[row] = behind_ns


def in_order(batch: FrameBatch) -> tuple[FrameBatch, Int64Array]:
    """Return frames in the order of their times, and how late each late one was [ns], shape (k,).

    Frames of one time keep their order. Where one of them was late nobody knows it, and they are put by channel,
    identifier and payload.
    """
    if len(batch) < 2 or np.diff(batch.t_ns).min() >= 0:
        return batch, np.empty(0, np.int64)
    late_ns, begins = np.empty(len(batch), np.int64), np.empty(len(batch), np.bool_)
    find_late(batch.t_ns, late_ns, begins)
    recording = np.cumsum(begins)
    order = np.lexsort((batch.t_ns, recording))
    at_ns, number = batch.t_ns[order], recording[order]
    is_next = (at_ns[1:] != at_ns[:-1]) | (number[1:] != number[:-1])
    moment = np.concatenate(([0], np.cumsum(is_next)))
    is_unsure = np.bincount(moment, late_ns[order] > 0)[moment] > 0
    rows = order[is_unsure]
    payload = batch.data[rows].T[::-1]
    keys = (*payload, batch.can_id[rows], batch.channel[rows], moment[is_unsure])
    order[is_unsure] = rows[np.lexsort(keys)]
    return batch[order], late_ns[late_ns > 0]


def compile_order() -> None:
    """Compile what the first late frame of a live bus must not wait for; most logs have none."""
    find_late(np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros(1, np.bool_))


def _last_recording(t_ns: Int64Array) -> int:
    """Return the first frame of the last recording."""
    steps_back = np.flatnonzero(np.diff(t_ns) < 0)
    return int(steps_back[-1]) + 1 if len(steps_back) else 0


class TimeOrder:
    """Puts the frames of a stream in order; holds the last moments back, so that no cutting changes what comes out.

    Parameters
    ----------
    least_count
        Fewer frames wait for the next ones: each batch costs whoever decodes it a call for every message. For a stream
        that somebody waits for it is 1.

    Attributes
    ----------
    late_count
        Frames that stood later than their times.
    most_late_ns
        By how much at most [ns].
    """

    def __init__(self, least_count: int = 1) -> None:
        self._least_count = least_count
        self.late_count = self.most_late_ns = 0
        self._held = empty_batch()

    def ordered(self, batches: Iterator[FrameBatch]) -> Iterator[FrameBatch]:
        """Yield all frames, those that are held back at the end too."""
        for batch in batches:
            if len(batch) and len(ready := self._ready(batch)):
                yield ready
        if len(self._held):
            yield self._held

    def _ready(self, batch: FrameBatch) -> FrameBatch:
        """Return the frames before which none can come any more, and hold the others back."""
        batch = join([self._held, batch]) if len(self._held) else batch
        frames, late_ns = in_order(batch)
        self.late_count += len(late_ns)
        self.most_late_ns = max(self.most_late_ns, int(late_ns.max(initial=0)))
        begin = 0 if frames is batch else _last_recording(frames.t_ns)
        sure = begin + int(np.searchsorted(frames.t_ns[begin:], frames.t_ns[-1] - LATE_NS))
        sure = max(sure if sure >= self._least_count else 0, len(frames) - HELD_FRAMES)
        self._held = frames[np.arange(sure, len(frames))]  # a copy: readers use their room again
        return frames[:sure]
