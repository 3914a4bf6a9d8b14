"""Frames that a busy machine received late, all in one burst: alive counters and cycle times tell when they were sent.

After a silence of the whole bus some frames are held until they say what it was. It was lateness if every counter goes
on where it stood and the frames come faster than they were sent. Until one is on time again, each frame then gets the
time at which the schedule of its sender has it; a frame without a counter gets that of the frame before it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import Int64Array, UInt8Array, UInt32Array
from canlog.database.addressing import NOBODY, AddressBook, find_slot
from canlog.e2e.alive_counter import LinkState
from canlog.e2e.profile1 import COUNTER_BYTE, COUNTER_MASK, COUNTER_PERIOD
from canlog.frames import ERROR_FLAG, MAX_GAP_NS, REMOTE_FLAG, FrameBatch, empty_batch, join
from canlog.jit import array_kernel

SILENCE_NS: Final = 150_000_000  # the whole bus is never as quiet while its messages come in time,
SILENT_CYCLES: Final = 10  # nor for so many cycles of the quickest one
HELD_FRAMES, HELD_NS = 96, 150_000_000  # held until either is full
FASTER_RATIO: Final = 0.9  # of the time in which frames came to the time in which they were sent
LEAST_COUNTED: Final = 6  # frames with a counter, to tell anything
LOSING_FRAMES: Final = 300  # without having caught up by a cycle: it is the sender that is late

_NO_DATA: Final = REMOTE_FLAG | ERROR_FLAG


class Schedules(NamedTuple):
    """When the senders of messages sent last, arrays of shape (m,)."""

    cycle_ns: Int64Array  # 0 of messages without an alive counter
    on_time_ns: int  # lateness that is none
    counter: Int64Array  # -1 where none is known
    sent_ns: Int64Array


class CatchingUp(NamedTuple):
    """How far a burst has come."""

    latest_ns: int  # newest time given
    received_ns: int
    least_late_ns: int
    since: int  # frames with a counter since then
    counted: int
    skipped: int  # of these, those that do not follow the one before them
    is_over: bool


@array_kernel
def seamless_rows(t_ns: Int64Array, before_ns: int, silence_ns: int) -> int:
    """Return how many frames come before a silence."""
    for row in range(t_ns.size):
        if t_ns[row] - before_ns > silence_ns:
            return row
        before_ns = t_ns[row]
    return int(t_ns.size)


@array_kernel
def held_rows(t_ns: Int64Array) -> int:
    """Return how many frames tell what the silence before them was."""
    for row in range(min(t_ns.size, HELD_FRAMES)):
        if not 0 <= t_ns[row] - t_ns[0] <= HELD_NS:
            return row
    return int(min(t_ns.size, HELD_FRAMES))


@array_kernel
def catch_up(
    book: AddressBook,
    schedules: Schedules,
    begun: CatchingUp,
    t_ns: Int64Array,
    can_id: UInt32Array,
    data: UInt8Array,
    sent_ns: Int64Array,
) -> tuple[int, CatchingUp]:
    """Fill in when frames were sent until one is on time, or comes before its forerunner; return how many were late."""
    latest_ns, received_ns, least_late_ns, since, counted, skipped, _ = begun
    for row in range(t_ns.size):
        due_ns, slot = latest_ns, NOBODY
        if can_id[row] & _NO_DATA == 0:
            slot = find_slot(book, can_id[row])
        if slot != NOBODY and schedules.cycle_ns[slot] > 0:
            counter = int(data[row, COUNTER_BYTE] & COUNTER_MASK)
            step = (counter - schedules.counter[slot]) % COUNTER_PERIOD
            if schedules.counter[slot] >= 0 and step > 0:
                due_ns = schedules.sent_ns[slot] + step * schedules.cycle_ns[slot]
                late_ns = t_ns[row] - due_ns
                since += 1
                if late_ns < least_late_ns - schedules.cycle_ns[slot]:
                    least_late_ns, since = late_ns, 0
                counted += 1
                skipped += step > 1
                if late_ns <= schedules.on_time_ns or since > LOSING_FRAMES:
                    return row, CatchingUp(latest_ns, received_ns, least_late_ns, since, counted, skipped, True)
            schedules.counter[slot], schedules.sent_ns[slot] = counter, due_ns
        if t_ns[row] < received_ns:
            return row, CatchingUp(latest_ns, received_ns, least_late_ns, since, counted, skipped, True)
        received_ns = t_ns[row]
        latest_ns = sent_ns[row] = min(max(latest_ns, due_ns), received_ns)
    return t_ns.size, CatchingUp(latest_ns, received_ns, least_late_ns, since, counted, skipped, False)


class LateFrames:
    """Gives frames of a burst the times at which they were sent; what comes out does not depend on the cutting.

    Parameters
    ----------
    book
        By which messages are known.
    cycle_ns : (m,) array
        Of messages with an alive counter; 0 of all others.
    links
        What is known of their counters, as it stands whenever a part is asked for.
    """

    def __init__(self, book: AddressBook, cycle_ns: Int64Array, links: LinkState) -> None:
        self._book, self._cycle_ns, self._links = book, cycle_ns, links
        self._quickest_ns = int(min(cycle_ns[cycle_ns > 0], default=0))
        self.silence_ns = max(SILENCE_NS, SILENT_CYCLES * self._quickest_ns) if self._quickest_ns else MAX_GAP_NS
        self.count = 0  # frames that got an earlier time
        self._held = empty_batch()
        self._schedules = self._schedules_of(cycle_ns)
        self._burst: CatchingUp | None = None
        self._resent(self._held, CatchingUp(0, 0, 0, 0, 0, 0, False))  # compiles now: the first burst must not wait
        held_rows(self._held.t_ns) + seamless_rows(self._held.t_ns, 0, 0)

    @property
    def is_idle(self) -> bool:
        """Whether nothing is held and nothing late is expected."""
        return self._burst is None and not len(self._held)

    def parts(
        self, batch: FrameBatch, before_ns: int, own_cycles_ns: Sequence[int], *, is_last: bool = False
    ) -> Iterator[FrameBatch]:
        """Yield frames in their order, each part to be looked at before the next one is asked for.

        ``before_ns`` is the time of the last one yielded. A few are held until others, or the last, tell what they are.
        """
        batch, self._held, is_judged = join([self._held, batch]), empty_batch(), False
        while len(batch):
            if self._burst is not None:
                part, burst = self._resent(batch, self._burst)
                self._burst = None if burst.is_over else burst
                self.count, is_judged = self.count + len(part), True
            elif row := seamless_rows(batch.t_ns, int(batch.t_ns[0]) if is_judged else before_ns, self.silence_ns):
                part, is_judged = batch[:row], False
            else:
                held = batch[: held_rows(batch.t_ns)]
                known_ns = self._cycle_ns[(self._links.valid_counter >= 0) & (self._cycle_ns > 0)]
                silence_ns = int(batch.t_ns[0]) - before_ns
                can_tell = len(known_ns) > 0 and silence_ns > SILENT_CYCLES * int(known_ns.min())
                if can_tell and not is_last and len(held) == len(batch) < HELD_FRAMES:
                    self._held = batch
                    return
                part = self._begin(held, before_ns, own_cycles_ns) if can_tell else batch[:0]
                is_judged = True
            if len(part):
                yield part
                before_ns, batch = int(part.t_ns[-1]), batch[len(part) :]
        if is_last:
            self._burst = None

    def _begin(self, held: FrameBatch, before_ns: int, own_cycles_ns: Sequence[int]) -> FrameBatch:
        """Return what is late of the frames behind a silence."""
        self._schedules = self._schedules_of(np.where(self._cycle_ns > 0, own_cycles_ns, 0))
        begun = CatchingUp(before_ns, int(held.t_ns[0]), 2**62, 0, 0, 0, False)
        part, burst = self._resent(held, begun)
        took_ns, sent_ns = burst.received_ns - begun.received_ns, burst.latest_ns - before_ns
        is_faster = burst.is_over or took_ns < FASTER_RATIO * sent_ns
        if burst.skipped or burst.counted < LEAST_COUNTED or not is_faster:
            return held[:0]
        self._burst = None if burst.is_over else burst
        self.count += len(part)
        return part

    def _schedules_of(self, cycle_ns: Int64Array) -> Schedules:
        on_time_ns = self._quickest_ns // 4
        return Schedules(cycle_ns, on_time_ns, self._links.valid_counter.copy(), self._links.valid_ns.copy())

    def _resent(self, batch: FrameBatch, burst: CatchingUp) -> tuple[FrameBatch, CatchingUp]:
        """Return the frames that are late at the times at which they were sent, and how the burst goes on."""
        sent_ns = np.empty(len(batch), np.int64)
        late, burst = catch_up(self._book, self._schedules, burst, batch.t_ns, batch.can_id, batch.data, sent_ns)
        return replace(batch[:late], t_ns=sent_ns[:late]), burst
