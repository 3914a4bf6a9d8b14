"""Frames that a busy or polling machine received late: alive counters give the times at which they were sent.

After a silence of the whole bus some frames are held until they say what it was. It was lateness if every counter goes
on where it stood, and the frames come faster than they were sent or are on time soon. Until all are on time again, each
frame then gets the time at which the schedule of its sender has it; one without a counter that of the frame before it.
A schedule is as early as its frames allow, since a bus only ever delays.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import Int64Array, Records, UInt8Array
from canlog.database.addressing import NOBODY, AddressBook, find_slots
from canlog.e2e.alive_counter import SLOWER_RATIO, learn_cycle
from canlog.e2e.profile1 import COUNTER_BYTE, COUNTER_MASK, COUNTER_PERIOD
from canlog.frames import BEFORE_ALL_NS, MAX_GAP_NS, FrameBatch, empty_batch, join
from canlog.jit import kernel, part

SILENT_CYCLES: Final = 1.2  # of the quickest message: the whole bus is never as quiet while its messages come in time
HELD_FRAMES, HELD_NS = 96, 150_000_000  # held until either is full
FASTER_RATIO: Final = 0.9  # of the time in which frames came to the time in which they were sent
LEAST_COUNTED: Final = 6  # frames with a counter that are needed
SETTLED_FRAMES: Final = 300  # without having caught up by a cycle: the least late of them is on time
_NO_CYCLE_NS: Final = 2**60


class Cadence:
    """How often a message comes while the bus is on time: a record of an array."""

    cycle_ns: int  # that the database names; 0 of messages without an alive counter
    own_ns: int  # that the message keeps, no less than the database's
    heard_ns: int  # last frame, BEFORE_ALL_NS before the first
    counter: int  # of that frame, whether or not it may be believed


CADENCE_TYPE: Final = np.dtype([(name, np.int64) for name in Cadence.__annotations__])


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
    begun_late_ns: int  # when it last had caught up by a cycle,
    since: int  # frames with a counter since then,
    least_late_ns: int  # of them
    most_late_ns: int
    counted: int
    skipped: int  # of these, those that do not follow the one before them
    is_over: bool


@part
def believed_cycle_ns(cadence: Cadence) -> int:
    """Return how often a message comes by itself: as the database says until it is plainly slower."""
    return cadence.own_ns if cadence.own_ns >= SLOWER_RATIO * cadence.cycle_ns else cadence.cycle_ns


@part
def silence_ns(cadences: Records) -> float:
    """Return for how long the bus is quiet at most while its messages come in time, as far as they were heard."""
    quickest_ns = _NO_CYCLE_NS
    for cadence in cadences:
        if cadence.cycle_ns > 0 and cadence.heard_ns > BEFORE_ALL_NS:
            quickest_ns = min(quickest_ns, believed_cycle_ns(cadence))
    return SILENT_CYCLES * quickest_ns


@part
def hear(cadence: Cadence, t_ns: int, counter: int) -> None:
    """Learn from one frame how often its message comes; its counter shows how many are missing before it."""
    learn_cycle(cadence, t_ns, (counter - cadence.counter) % COUNTER_PERIOD - 1)
    cadence.heard_ns, cadence.counter = t_ns, counter


@kernel
def learn_cadences(cadences: Records, t_ns: Int64Array, slot: Int64Array, data: UInt8Array) -> None:
    """Learn from frames in their order."""
    for row in range(t_ns.size):
        if slot[row] != NOBODY and cadences[slot[row]].cycle_ns > 0:
            hear(cadences[slot[row]], t_ns[row], int(data[row, COUNTER_BYTE] & COUNTER_MASK))


@kernel
def rows_on_time(cadences: Records, before_ns: int, t_ns: Int64Array, slot: Int64Array, data: UInt8Array) -> int:
    """Return how many frames come before a silence of the whole bus; learn from these how often messages come."""
    for row in range(t_ns.size):
        if t_ns[row] - before_ns > silence_ns(cadences):
            return row
        before_ns = t_ns[row]
        if slot[row] != NOBODY and cadences[slot[row]].cycle_ns > 0:
            hear(cadences[slot[row]], t_ns[row], int(data[row, COUNTER_BYTE] & COUNTER_MASK))
    return t_ns.size


def held_rows(t_ns: Int64Array) -> int:
    """Return how many frames decide whether the silence before them was lateness."""
    since_ns = t_ns[:HELD_FRAMES] - t_ns[0]
    is_other = (since_ns < 0) | (since_ns > HELD_NS)
    return int(is_other.argmax()) if is_other.any() else len(since_ns)


@kernel
def catch_up(
    schedules: Schedules, begun: CatchingUp, t_ns: Int64Array, slot: Int64Array, data: UInt8Array, sent_ns: Int64Array
) -> tuple[int, CatchingUp]:
    """Fill in when frames were sent until all are on time, or one comes before its forerunner; return how many."""
    latest_ns, received_ns, begun_late_ns, since, least_late_ns, most_late_ns, counted, skipped, _ = begun
    for row in range(t_ns.size):
        due_ns, message = latest_ns, slot[row]
        if message != NOBODY and schedules.cycle_ns[message] > 0:
            counter = int(data[row, COUNTER_BYTE] & COUNTER_MASK)
            step = (counter - schedules.counter[message]) % COUNTER_PERIOD
            if schedules.counter[message] >= 0 and step > 0:
                due_ns = schedules.sent_ns[message] + step * schedules.cycle_ns[message]
                late_ns = max(t_ns[row] - due_ns, 0)
                if late_ns < begun_late_ns - schedules.cycle_ns[message]:
                    begun_late_ns = least_late_ns = most_late_ns = late_ns
                    since = 0
                least_late_ns, most_late_ns = min(least_late_ns, late_ns), max(most_late_ns, late_ns)
                since += 1
                counted += 1
                skipped += step > 1
            schedules.counter[message], schedules.sent_ns[message] = counter, min(due_ns, t_ns[row])
        is_over = t_ns[row] < received_ns
        if since > SETTLED_FRAMES:
            is_over |= most_late_ns <= schedules.on_time_ns
            for place in range(schedules.sent_ns.size):
                schedules.sent_ns[place] += least_late_ns
            begun_late_ns = 2**62
        if is_over:
            return row, CatchingUp(latest_ns, received_ns, 0, 0, 0, 0, counted, skipped, True)
        received_ns = t_ns[row]
        latest_ns = sent_ns[row] = min(max(latest_ns, due_ns), received_ns)
    state = latest_ns, received_ns, begun_late_ns, since, least_late_ns, most_late_ns, counted, skipped
    return t_ns.size, CatchingUp(*state, False)


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

    def __init__(self, book: AddressBook, cycle_ns: Int64Array, links: Records) -> None:
        self._book, self._links = book, links
        self._cadences = np.zeros(len(cycle_ns), CADENCE_TYPE)
        self._cadences["cycle_ns"] = self._cadences["own_ns"] = cycle_ns
        self._cadences["heard_ns"] = BEFORE_ALL_NS
        self._quickest_ns = int(min(cycle_ns[cycle_ns > 0], default=0))
        self.silence_ns = int(SILENT_CYCLES * self._quickest_ns) if self._quickest_ns else MAX_GAP_NS
        self._on_time_ns = self._quickest_ns // 4
        self.count = 0  # frames that got an earlier time
        self._held = empty_batch()
        self._schedules = self._schedules_of()
        self._burst: CatchingUp | None = None
        self.learn(self._held)  # compiles now: the first real batch must not wait for the compiler

    def compile(self) -> None:
        """Compile what the first burst of a live bus must not wait for; most logs have none."""
        self._resent(self._held, CatchingUp(0, 0, 0, 0, 0, 0, 0, 0, False))
        self._rows_on_time(self._held, 0)

    @property
    def is_idle(self) -> bool:
        """Whether nothing is held and nothing late is expected."""
        return self._burst is None and not len(self._held)

    def learn(self, batch: FrameBatch) -> None:
        """Learn how often messages come from frames that are yielded as they are, or at the times they were sent."""
        learn_cadences(self._cadences, batch.t_ns, find_slots(self._book, batch.can_id), batch.data)

    def parts(self, batch: FrameBatch, before_ns: int, *, is_last: bool = False) -> Iterator[FrameBatch]:
        """Yield frames in their order, each part to be looked at before the next one is asked for.

        ``before_ns`` is the time of the last one yielded. A few are held until others, or the last, tell what they are.
        """
        batch, self._held, is_judged = join([self._held, batch]), empty_batch(), False
        while len(batch):
            if self._burst is not None:
                gaps = np.diff(batch.t_ns, prepend=self._burst.received_ns) > HELD_NS
                rows = int(gaps.argmax()) if gaps.any() else len(batch)
                part, burst = self._resent(batch[:rows], self._burst)
                self.learn(part)
                self._burst, is_judged = None if burst.is_over or rows < len(batch) else burst, burst.is_over
            elif row := self._rows_on_time(batch, int(batch.t_ns[0]) if is_judged else before_ns):
                part, is_judged = batch[:row], False
            else:
                held = batch[: held_rows(batch.t_ns)]
                if not is_last and len(held) == len(batch) < HELD_FRAMES:
                    self._held = batch
                    return
                part, is_judged = self._begin(held, before_ns), True
                self.learn(part)
            if len(part):
                self.count += int(np.count_nonzero(batch.t_ns[: len(part)] - part.t_ns > self._on_time_ns))
                yield part
                before_ns, batch = int(part.t_ns[-1]), batch[len(part) :]
        if is_last:
            self._burst = None

    def _rows_on_time(self, batch: FrameBatch, before_ns: int) -> int:
        slot = find_slots(self._book, batch.can_id)
        return int(rows_on_time(self._cadences, before_ns, batch.t_ns, slot, batch.data))

    def _begin(self, held: FrameBatch, before_ns: int) -> FrameBatch:
        """Return what is late of the frames behind a silence."""
        if held.t_ns[0] - before_ns > MAX_GAP_NS:
            self._cadences["heard_ns"] = BEFORE_ALL_NS  # after a jump of bus time every message is new
        self._schedules = self._schedules_of()
        begun = CatchingUp(before_ns, int(held.t_ns[0]), 2**62, 0, 0, 0, 0, 0, False)
        part, burst = self._resent(held, begun)
        took_ns, sent_ns = burst.received_ns - begun.received_ns, burst.latest_ns - before_ns
        is_faster = burst.least_late_ns < self._quickest_ns or took_ns < FASTER_RATIO * sent_ns
        if burst.skipped or burst.counted < LEAST_COUNTED or not is_faster:
            return held[:0]
        self._burst = None if burst.is_over else burst
        return part

    def _schedules_of(self) -> Schedules:
        known, cadences = self._links, self._cadences
        is_slower = cadences["own_ns"] >= SLOWER_RATIO * cadences["cycle_ns"]
        cycle_ns = np.where(is_slower, cadences["own_ns"], cadences["cycle_ns"])
        return Schedules(cycle_ns, self._on_time_ns, known["valid_counter"].copy(), known["valid_ns"].copy())

    def _resent(self, batch: FrameBatch, burst: CatchingUp) -> tuple[FrameBatch, CatchingUp]:
        """Return the frames that are late at the times at which they were sent, and how the burst goes on."""
        sent_ns = np.empty(len(batch), np.int64)
        slot = find_slots(self._book, batch.can_id)
        late, burst = catch_up(self._schedules, burst, batch.t_ns, slot, batch.data, sent_ns)
        return replace(batch[:late], t_ns=sent_ns[:late]), burst
