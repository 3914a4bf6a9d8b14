"""How an alive counter should move, and what its jumps say about lost, late and stray frames.

The counter check follows profile 1, with elapsed bus time in the place of its cyclic calls: each cycle without valid
data widens the permitted jump by one. Where profile 1 leaves room, this receiver does the following.

- The first frame of a message, and the first after a jump of bus time, is accepted: there is nothing to compare.
- A jump beyond what the elapsed time permits rejects that one frame and remembers it. The next frame is accepted if
  it continues either the last accepted one (the odd frame was a stray) or the remembered one (the sender's counter
  restarted). A restart of a sender therefore costs one frame at most.
- A counter that does not move rejects every frame until it moves. The same counter after one or more whole periods
  of lost frames, on time to a cycle, is not stuck; but once stuck, time is no excuse.
- Losses longer than the counter's period are counted by time, those longer than ``SILENT_CYCLES`` not at all: the
  sender was off, or the car parked, and any counter is accepted. If the frames turn out to have been late instead (the
  next ones come sooner than the schedule has them, which no sender's do), the count of missing frames is taken back;
  sequence numbers only ever grow. A late sender may catch up. Only a loss of a whole period while its sender was late
  cannot be counted: it leaves no trace.
"""

from collections.abc import Iterable, Sequence
from typing import Final, Protocol

import numpy as np

from canlog.arrays import Int64Array, Records, Series
from canlog.e2e.profile1 import COUNTER_PERIOD
from canlog.frames import BEFORE_ALL_NS
from canlog.jit import part

MAX_DELTA_COUNTER: Final = 3  # permitted jump between frames one cycle apart: two frames may be lost in silence
LATE_CYCLES: Final = 1.0  # jitter within which a gap still counts as whole counter periods
BURST_CYCLES: Final = 0.5  # frames closer than this were held back, not sent one cycle apart
AHEAD_CYCLES: Final = 2.0  # frames that come so much sooner than frames counted by time permit: those were late
SILENT_CYCLES: Final = 8.0 * COUNTER_PERIOD  # of which nothing came: by chance one counter in five would fit any pause

IN_SEQUENCE, REPEATED, WRONG_SEQUENCE = range(3)  # verdicts on one frame

_NONE: Final = -1
SLOWEST: Final = 5  # cycles of the database; a message that comes less often has gaps, not another cycle
SLOWER_RATIO: Final = 1.25  # below it the database is believed: jitter is no other cycle
LEAST_STEPS: Final = 8
LEARNING_STEPS: Final = 16  # over which the own cycle of a message forgets; one gap moves it by a sixteenth at most
LEAST_REGULAR: Final = 0.5  # share of the steps that must be near the typical one
NEAR: Final = 0.25  # of the typical step
LEAST_SHARED: Final = 0.8  # of the times of columns: cells may be blank
NS_PER_MS: Final = 1_000_000


class LinkState:
    """What is remembered of a message: a record of an array; counters are -1 where there is none."""

    valid_counter: int  # last accepted frame
    valid_ns: int
    sequence: int  # its transmission number
    stray_counter: int  # last frame rejected for its jump
    stray_ns: int
    seen_counter: int  # last frame with a good CRC
    seen_ns: int
    is_stuck: int
    rejected: int  # frames rejected since the last accepted one that stood in for a transmission
    rejected_after_stray: int
    late: int  # cycles by which the sender may still catch up; fades while it does not
    assumed: int  # frames counted as missing lately on the evidence of time alone
    assumed_ns: int  # when that began
    assumed_sequence: int
    held_back: int  # frames that came right behind the one before: that one was late
    heard_ns: int  # last accepted frame, with or without a counter; BEFORE_ALL_NS before the first


LINK_TYPE: Final = np.dtype([(name, np.int64) for name in LinkState.__annotations__])


def fresh_links(count: int) -> Records:
    """Return the state of some messages of which nothing was seen, of `LINK_TYPE`."""
    links = np.zeros(count, LINK_TYPE)
    links["sequence"] = _NONE
    forget(links)
    return links


def forget(links: Records) -> None:
    """Forget counters and times, after a jump of bus time; sequence numbers go on."""
    for name in set(LinkState.__annotations__) - {"sequence", "held_back"}:
        links[name] = _NONE if name.endswith("counter") else 0
    links["heard_ns"] = BEFORE_ALL_NS


@part
def elapsed_cycles(elapsed_ns: int, cycle_ns: int) -> float:
    """Return elapsed time in cycles; -1 if the cycle time is unknown."""
    return elapsed_ns / cycle_ns if cycle_ns > 0 else -1.0


@part
def whole_periods(delta: int, cycles: float) -> int:
    """Return how many counter periods passed unseen, if the frame is on time for that; else 0."""
    periods = int(np.rint((cycles - delta) / COUNTER_PERIOD))
    if periods > 0 and abs(cycles - delta - COUNTER_PERIOD * periods) <= LATE_CYCLES:
        return int(periods)
    return 0


@part
def permitted_advance(counter: int, since: int, cycles: float, late: int) -> int:
    """Return by how many transmissions ``counter`` follows the counter ``since``; 0 if time does not permit it.

    A sender that was ``late`` by some cycles may catch up by as many.
    """
    delta = (counter - since) % COUNTER_PERIOD
    periods = whole_periods(delta, cycles)
    if periods > 0:
        return delta + COUNTER_PERIOD * periods
    limit = MAX_DELTA_COUNTER - 1 + max(1, int(np.rint(cycles)) + late)
    return delta if delta <= limit else 0


@part
def retracted(link: LinkState, t_ns: int, cycles: float) -> int:
    """Return how many frames were not missing after all: those that follow come too soon for that."""
    assumed, since = link.assumed, link.sequence - link.assumed_sequence
    if assumed == 0 or cycles < 0.0:
        return 0
    cycle_ns = (t_ns - link.valid_ns) / cycles if cycles > 0.0 else 0.0
    ahead_ns = since * cycle_ns - (t_ns - link.assumed_ns)
    if cycles < BURST_CYCLES or ahead_ns > AHEAD_CYCLES * cycle_ns:
        link.assumed = 0
        return assumed
    if since > SILENT_CYCLES:
        link.assumed = 0
    return 0


@part
def accept(link: LinkState, counter: int, t_ns: int, advance: int, proven: int, cycles: float) -> int:
    """Move the state on to an accepted frame; return how many frames are missing before it.

    ``advance`` counts transmissions since the last accepted frame, ``proven`` those that the counter itself shows.
    """
    missing = max(0, advance - 1 - link.rejected)
    assumed = missing - max(0, proven - 1 - link.rejected)
    if cycles >= BURST_CYCLES:
        late = max(link.late - 1, int(np.rint(cycles)) - advance)
    else:
        late = link.late - advance
        link.held_back += cycles >= 0.0
    link.late = max(0, late)
    link.sequence += advance
    missing -= retracted(link, t_ns, cycles)
    if assumed > 0 and link.assumed == 0:
        link.assumed_ns = t_ns
        link.assumed_sequence = link.sequence
    link.assumed += assumed
    link.valid_counter = counter
    link.valid_ns = t_ns
    link.stray_counter = _NONE
    link.rejected = 0
    return missing


@part
def is_repeated(link: LinkState, counter: int, t_ns: int, cycle_ns: int) -> bool:
    """Return whether the counter has not moved since the last frame; remember the frame."""
    same = counter == link.seen_counter
    cycles = elapsed_cycles(t_ns - link.seen_ns, cycle_ns)
    repeated = same and (link.is_stuck == 1 or (whole_periods(0, cycles) == 0 and cycles <= SILENT_CYCLES))
    if repeated and cycles >= BURST_CYCLES:
        link.rejected += 1
        link.rejected_after_stray += 1
    link.is_stuck = 1 if repeated else 0
    link.seen_counter = counter
    link.seen_ns = t_ns
    return repeated


@part
def judge(link: LinkState, counter: int, t_ns: int, cycle_ns: int) -> tuple[int, int]:
    """Return reason and missing frames of one frame with a good CRC, and move the state on."""
    if counter >= COUNTER_PERIOD:
        link.rejected += 1
        return WRONG_SEQUENCE, 0
    if is_repeated(link, counter, t_ns, cycle_ns):
        return REPEATED, 0
    is_first = link.valid_counter == _NONE
    cycles = elapsed_cycles(t_ns - link.valid_ns, cycle_ns)
    if is_first or cycles - link.rejected > SILENT_CYCLES:
        by_time = 1 if is_first else int(np.rint(cycles))
        accept(link, counter, t_ns, by_time, by_time, -1.0)
        return IN_SEQUENCE, 0
    advance = permitted_advance(counter, link.valid_counter, cycles, link.late)
    if advance > 0:
        proven = (counter - link.valid_counter) % COUNTER_PERIOD
        return IN_SEQUENCE, accept(link, counter, t_ns, advance, proven, cycles)
    if link.stray_counter != _NONE:
        stray_cycles = elapsed_cycles(t_ns - link.stray_ns, cycle_ns)
        restarted = permitted_advance(counter, link.stray_counter, stray_cycles, 0)
        if restarted > 0:
            # How many were sent around the restart is unknown: time numbers them, only the counter proves a loss.
            missing = max(0, restarted - 1 - link.rejected_after_stray)
            by_time = max(1, int(np.rint(cycles))) if cycle_ns > 0 else restarted + link.rejected
            accept(link, counter, t_ns, by_time, by_time, -1.0)
            return IN_SEQUENCE, missing
    link.stray_counter = counter
    link.stray_ns = t_ns
    link.rejected_after_stray = 0
    if not 0.0 <= cycles < BURST_CYCLES:
        link.rejected += 1
    return WRONG_SEQUENCE, 0


@part
def note_unusable(link: LinkState) -> None:
    """Remember a frame that stood in for a transmission but could not be read."""
    link.rejected += 1
    link.rejected_after_stray += 1


class CycleMemory(Protocol):
    """What is remembered of how often a message comes: fields of a record of an array."""

    cycle_ns: int  # that the database names; 0 where that is unknown
    own_ns: int  # that the message keeps, no less than the database's
    heard_ns: int  # last frame of whatever kind, BEFORE_ALL_NS before the first


@part
def learn_cycle(memory: CycleMemory, now_ns: int, missing: int) -> None:
    """Take the time since the last frame into account, frames that are missing in between left out."""
    own_ns, cycle_ns = memory.own_ns, memory.cycle_ns
    if own_ns > 0 and memory.heard_ns > BEFORE_ALL_NS:
        step_ns = (now_ns - memory.heard_ns) // (1 + max(missing, 0))
        step_ns = min(max(step_ns, own_ns // 2), 2 * own_ns)
        own_ns += (step_ns - own_ns) // LEARNING_STEPS
        memory.own_ns = min(max(own_ns, cycle_ns), SLOWEST * cycle_ns)


def own_period_ns(series: Series) -> int:
    """Return the cycle that the samples of a stretch keep [ns]; the database's unless they plainly keep a slower one.

    Cycles are whole milliseconds. A stretch that is too short, without a regular step, or slower than ``SLOWEST``
    cycles of the database is held against the database, and fails there.
    """
    if series.period_ns <= 0 or len(series.t_ns) <= LEAST_STEPS:
        return series.period_ns
    if most_are_shorter(series.t_ns, series.sequence, SLOWER_RATIO * series.period_ns):
        return series.period_ns  # what follows would say so too, at length
    # From one transmission to the next: over the whole stretch, and wherever two samples tell it.
    steps_ns, count = np.diff(series.t_ns).astype(np.float64), len(series.t_ns) - 1
    if series.sequence[0] >= 0:
        steps_ns /= np.maximum(np.diff(series.sequence), 1)
        count = int(series.sequence[-1] - series.sequence[0])
    mean_ns = int(series.t_ns[-1] - series.t_ns[0]) / max(count, 1)
    typical_ns = float(np.median(steps_ns))
    if not SLOWER_RATIO * series.period_ns <= typical_ns <= (SLOWEST + NEAR) * series.period_ns:
        return series.period_ns
    if abs(mean_ns - typical_ns) > NEAR * typical_ns:
        return series.period_ns  # a sender that waits too long and then makes up for it keeps its cycle
    regular_ns = steps_ns[np.abs(steps_ns - typical_ns) <= NEAR * typical_ns]
    if len(regular_ns) < LEAST_REGULAR * len(steps_ns):
        return series.period_ns
    own_ns = round(float(regular_ns.mean()) / NS_PER_MS) * NS_PER_MS
    return own_ns if series.period_ns < own_ns <= SLOWEST * series.period_ns else series.period_ns


def came_in_bursts(columns: Iterable[Series]) -> bool:
    """Return whether samples came closer than their sender sends them: it, or whoever received them, was late."""
    for series in columns:  # noqa: SIM110 - a generator is many calls
        if (np.diff(series.t_ns) < BURST_CYCLES * series.period_ns).any():
            return True
    return False


def row_period_ns(columns: Sequence[Series]) -> int:
    """Return the time from row to row [ns] of a table whose columns these are; 0 if they are none of one."""
    times_ns = columns[0].t_ns
    return int(np.median(np.diff(times_ns))) if len(times_ns) > 1 and share_rows(columns) else 0


def share_rows(columns: Sequence[Series]) -> bool:
    """Return whether columns have the times of the rows of one table; messages of a bus have their own, or counters."""
    if any(series.period_ns or not len(series.t_ns) or series.sequence[0] >= 0 for series in columns):
        return False
    return all(np.isin(series.t_ns, columns[0].t_ns).mean() >= LEAST_SHARED for series in columns[1:])


def most_are_shorter(t_ns: Int64Array, sequence: Int64Array, limit_ns: float) -> bool:
    """Return whether more than half of the steps, and so the typical one, are shorter than a limit [ns]."""
    steps_ns = np.diff(t_ns)
    if sequence[0] >= 0:
        limits_ns = limit_ns * np.maximum(np.diff(sequence), 1)
        return bool(2 * np.count_nonzero(steps_ns < limits_ns) > len(steps_ns))
    return bool(2 * np.count_nonzero(steps_ns < limit_ns) > len(steps_ns))
