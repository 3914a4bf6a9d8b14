"""How the time of a bus goes on, by the frames of messages that are followed; the others only show that it lives.

A followed frame that lies more than ``LATE_NS`` before the latest one, or more than ``MAX_GAP_NS`` behind all that was
heard, begins a new segment. A frame of another message may come from anywhere, with any clock: it ends nothing.
"""

from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import BoolArray, Int64Array, Records
from canlog.database.addressing import NOBODY, AddressBook, find_slots
from canlog.e2e.protection_check import FrameVerdicts
from canlog.frames import BEFORE_ALL_NS, MAX_GAP_NS, FrameBatch, empty_batch
from canlog.jit import kernel
from canlog.time_order import LATE_NS


class BusMoment:
    """How far the time of a bus has come: a record of an array; BEFORE_ALL_NS before the first frame."""

    followed_ns: int  # latest frame of a followed message
    alive_ns: int  # latest frame of any message that fits behind it
    late_count: int  # followed frames that lay up to LATE_NS before it


_MOMENT_TYPE: Final = np.dtype([(name, np.int64) for name in BusMoment.__annotations__])


class Walked(NamedTuple):
    """The frames of a batch on the time of the bus, arrays of shape (n,)."""

    t_ns: Int64Array  # a frame of another message has no other time than those around it
    is_break: BoolArray  # a new segment begins


@kernel
def walk(moments: Records, t_ns: Int64Array, is_followed: BoolArray, walked: Walked) -> None:
    """Go through frames in their order, and move the moment on."""
    moment, since = moments[0], 0  # the first frame behind the last followed one
    for row in range(t_ns.size):
        at_ns, followed_ns, alive_ns = t_ns[row], moment.followed_ns, moment.alive_ns
        is_first = followed_ns == BEFORE_ALL_NS
        walked.is_break[row] = False
        if is_followed[row]:
            is_break = not is_first and (at_ns < followed_ns - LATE_NS or at_ns > alive_ns + MAX_GAP_NS)
            walked.is_break[row], walked.t_ns[row] = is_break, at_ns
            moment.late_count += not is_break and at_ns < followed_ns
            moment.followed_ns = at_ns if is_break else max(followed_ns, at_ns)
            for other in range(since if not is_break else row, row):
                walked.t_ns[other] = min(walked.t_ns[other], moment.followed_ns)
            moment.alive_ns, since = moment.followed_ns, row + 1
            continue
        if alive_ns == BEFORE_ALL_NS or alive_ns <= at_ns <= alive_ns + MAX_GAP_NS:
            moment.alive_ns = at_ns
        # With a clock that is ahead it must not run away from those that are followed, unless these have fallen silent.
        is_near = is_first or moment.alive_ns - followed_ns <= LATE_NS
        walked.t_ns[row] = moment.alive_ns if is_near else max(followed_ns + LATE_NS, moment.alive_ns - MAX_GAP_NS)


class BusTime:
    """Walks along the frames of a bus; the same for any cutting of the stream, but for what is ahead at its end.

    Parameters
    ----------
    book
        By which the messages that are followed are known.
    """

    def __init__(self, book: AddressBook) -> None:
        self._book = book
        self._moments = np.zeros(1, _MOMENT_TYPE)
        self.forget()
        self.walk(empty_batch())  # compiles now: the first real batch must not wait for the compiler

    @property
    def late_count(self) -> int:
        """Followed frames that came behind later ones, by up to ``LATE_NS``."""
        return int(self._moments[0]["late_count"])

    def forget(self) -> None:
        """Begin anew: what comes next breaks with nothing."""
        self._moments["followed_ns"] = self._moments["alive_ns"] = BEFORE_ALL_NS

    def walk(self, batch: FrameBatch) -> Walked:
        """Return the frames on the time of the bus."""
        walked = Walked(np.empty(len(batch), np.int64), np.empty(len(batch), np.bool_))
        walk(self._moments, batch.t_ns, find_slots(self._book, batch.can_id) != NOBODY, walked)
        return walked

    def go_on(self, t_ns: Int64Array, verdicts: FrameVerdicts) -> None:
        """Note frames that are in order and close together, as they nearly always are: there is nothing to walk."""
        followed = np.flatnonzero(verdicts.slot != NOBODY)
        if len(followed):
            self._moments["followed_ns"] = t_ns[followed[-1]]
        self._moments["alive_ns"] = t_ns[-1]
