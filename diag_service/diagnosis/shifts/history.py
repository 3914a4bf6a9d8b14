"""The recent past of a stream of column batches: what the finders of events look back on, with bounded memory."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array, Series
from canlog.e2e.alive_counter import compile_now, own_period_ns
from canlog.e2e.e2e_state import E2eChange, E2eState
from canlog.frames import BEFORE_ALL_NS
from canlog.jit import array_kernel
from diag_service.diagnosis.columns import BlockLayout, ColumnBatch, Columns, SampleBlock, Samples, Signal, empty_rows

FIRST_CAPACITY: Final = 256  # samples of a signal; grows by doubling
_FULL: Final = -1


class SampleRings:
    """Rows of samples that grow at their end and are forgotten at their beginning.

    What ``between`` returns is valid until something is appended; who keeps it copies it.
    """

    def __init__(self) -> None:
        self.clear()
        compile_rings()

    @property
    def sample_count(self) -> int:
        return int((self._samples.filled - self._first).sum())

    def append(self, columns: Mapping[Signal, Series]) -> None:
        if isinstance(columns, SampleBlock):
            self._append_block(columns)
            return
        for signal, series in columns.items():
            if len(series.t_ns):
                rows = np.array([self._row(signal, series.period_ns)], np.int64)
                size = np.array([len(series.t_ns)], np.int64)
                self._append_rows(rows, Samples(size, series.t_ns[None], series.sequence[None], series.value[None]))

    def between(self, signal: Signal, start_ns: int, stop_ns: int) -> Series:
        """Return the samples of a signal with ``start_ns <= t_ns < stop_ns``; none if there is no such signal."""
        row = self._rows.get(signal)
        if row is None:
            return _NO_SAMPLES
        first, stop = self._first[row], self._samples.filled[row]
        low, high = (first + self._samples.t_ns[row, first:stop].searchsorted((start_ns, stop_ns))).tolist()
        return Series(
            t_ns=self._samples.t_ns[row, low:high],
            sequence=self._samples.sequence[row, low:high],
            value=self._samples.value[row, low:high],
            period_ns=self._period_ns[row],
        )

    def cut(self, start_ns: int, stop_ns: int) -> dict[Signal, Series]:
        """Return copies of the samples of all signals that ever had one, with ``start_ns <= t_ns < stop_ns``."""
        low, ends = np.empty(len(self._first), np.int64), np.zeros(len(self._first) + 1, np.int64)
        count = find_rows(self._samples, self._first, start_ns, stop_ns, low, ends)
        t_ns, sequence, value = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count)
        copy_rows(self._samples, low, ends, t_ns, sequence, value)
        places, filled = ends.tolist(), self._samples.filled.tolist()
        parts = {signal: slice(*places[row : row + 2]) for signal, row in self._rows.items() if filled[row]}
        return {
            signal: Series(
                t_ns=t_ns[part],
                sequence=sequence[part],
                value=value[part],
                period_ns=self._period_ns[self._rows[signal]],
            )
            for signal, part in parts.items()
        }

    def changed_ns(self, signal: Signal) -> int:
        """Return when a sample of a signal last differed from the one before it, as the first one does."""
        row = self._rows.get(signal)
        return BEFORE_ALL_NS if row is None else int(self._changed_ns[row])

    def drop_before(self, keep_ns: int) -> None:
        """Forget what lies before ``keep_ns``."""
        drop_before(self._samples, self._first, keep_ns)

    def clear(self) -> None:
        self._rows: dict[Signal, int] = {}
        self._period_ns: list[int] = []
        self._first = np.zeros(0, np.int64)
        self._changed_ns = np.zeros(0, np.int64)
        self._samples = empty_rows(0, FIRST_CAPACITY)
        self._block_rows: tuple[BlockLayout, Int64Array] | None = None

    def _append_block(self, block: SampleBlock) -> None:
        if self._block_rows is None or self._block_rows[0] is not block.layout:
            named = zip(block.layout.signals, block.layout.period_ns, strict=True)
            rows = np.array([self._row(signal, period_ns) for signal, period_ns in named], np.int64)
            self._block_rows = block.layout, rows
        self._append_rows(self._block_rows[1], block.samples)

    def _append_rows(self, rows: Int64Array, block: Samples) -> None:
        while append_rows(self._samples, self._first, self._changed_ns, rows, block) == _FULL:
            self._resize(len(self._period_ns), 2 * self._samples.t_ns.shape[1])

    def _row(self, signal: Signal, period_ns: int) -> int:
        """Return the row of a signal, a new one if it has none."""
        row = self._rows.setdefault(signal, len(self._rows))
        if row == len(self._period_ns):
            self._period_ns.append(period_ns)
            self._resize(row + 1, self._samples.t_ns.shape[1])
        return row

    def _resize(self, rows: int, capacity: int) -> None:
        old, larger = self._samples, empty_rows(rows, capacity)
        known, size = old.t_ns.shape
        for name in ("t_ns", "sequence", "value"):
            getattr(larger, name)[:known, :size] = getattr(old, name)
        larger.filled[:known] = old.filled
        self._first = np.append(self._first, np.zeros(rows - known, np.int64))
        self._changed_ns = np.append(self._changed_ns, np.full(rows - known, BEFORE_ALL_NS))
        self._samples = larger


_NO_SAMPLES: Final = Series(t_ns=np.empty(0, np.int64), sequence=np.empty(0, np.int64), value=np.empty(0))


@array_kernel
def make_room(ring: Samples, first: Int64Array, row: int, count: int) -> int:
    """Move a row to its beginning if it must make room for more; return -1 if it is too short for that."""
    capacity = ring.t_ns.shape[1]
    stop = ring.filled[row]
    if stop + count <= capacity:
        return 0
    # One forgotten sample stays in front: a row that ends at 0 never had any.
    kept = min(first[row], 1)
    held = stop - first[row]
    if 2 * (kept + held + count) > capacity:  # moving a few samples again and again would be the dearest way
        return _FULL
    for at in range(held):
        ring.t_ns[row, kept + at] = ring.t_ns[row, first[row] + at]
        ring.sequence[row, kept + at] = ring.sequence[row, first[row] + at]
        ring.value[row, kept + at] = ring.value[row, first[row] + at]
    first[row] = kept
    ring.filled[row] = kept + held
    return 0


@array_kernel
def append_rows(ring: Samples, first: Int64Array, changed_ns: Int64Array, rows: Int64Array, block: Samples) -> int:
    """Append every row of a block to its ring, and note when values changed.

    Return -1, and leave all as it was, if one of the rings is too short.
    """
    for number in range(rows.size):
        if make_room(ring, first, rows[number], block.filled[number]) == _FULL:
            return _FULL
    for number in range(rows.size):
        row = rows[number]
        stop = ring.filled[row]
        for at in range(block.filled[number]):
            ring.t_ns[row, stop + at] = block.t_ns[number, at]
            ring.sequence[row, stop + at] = block.sequence[number, at]
            ring.value[row, stop + at] = block.value[number, at]
            if stop + at == 0 or ring.value[row, stop + at] != ring.value[row, stop + at - 1]:
                changed_ns[row] = block.t_ns[number, at]
        ring.filled[row] = stop + block.filled[number]
    return 0


@array_kernel
def drop_before(ring: Samples, first: Int64Array, keep_ns: int) -> None:
    """Move the beginning of every row behind the samples that lie before ``keep_ns``."""
    for row in range(first.size):
        while first[row] < ring.filled[row] and ring.t_ns[row, first[row]] < keep_ns:
            first[row] += 1


@array_kernel
def find_rows(ring: Samples, first: Int64Array, start_ns: int, stop_ns: int, low: Int64Array, ends: Int64Array) -> int:
    """Fill in where the samples with ``start_ns <= t_ns < stop_ns`` begin in each ring, and where they end in a copy.

    Return how many there are.
    """
    for row in range(first.size):
        t_ns = ring.t_ns[row, first[row] : ring.filled[row]]
        begin, end = np.searchsorted(t_ns, start_ns), np.searchsorted(t_ns, stop_ns)
        low[row] = first[row] + begin
        ends[row + 1] = ends[row] + max(end - begin, 0)
    return int(ends[-1])


@array_kernel
def copy_rows(
    ring: Samples, low: Int64Array, ends: Int64Array, t_ns: Int64Array, sequence: Int64Array, value: FloatArray
) -> None:
    """Copy what `find_rows` found, ring after ring."""
    for row in range(low.size):
        for at in range(ends[row], ends[row + 1]):
            taken = low[row] + at - ends[row]
            t_ns[at], sequence[at] = ring.t_ns[row, taken], ring.sequence[row, taken]
            value[at] = ring.value[row, taken]


def compile_rings() -> None:
    """Have everything compiled before the first frames come: they must not wait for it."""
    ring, block, first = empty_rows(1, 1), empty_rows(0, 0), np.zeros(1, np.int64)
    append_rows(ring, first, np.zeros(1, np.int64), np.empty(0, np.int64), block)
    drop_before(ring, first, 0)
    low, ends = np.zeros(1, np.int64), np.zeros(2, np.int64)
    copy_rows(ring, low, ends, low, low, np.zeros(find_rows(ring, first, 0, 0, low, ends)))


class History:
    """The recent samples of all signals, the times of bad frames and the states of messages, until they are dropped."""

    def __init__(self) -> None:
        self._rings = SampleRings()
        compile_now()
        self._bad_ns: list[Int64Array] = []
        self._e2e: dict[str, list[E2eChange]] = {}
        self.watermark_ns = BEFORE_ALL_NS  # all that happened before it has been seen
        self.walked_ns = BEFORE_ALL_NS  # up to where a tracker has looked at the samples

    @property
    def sample_count(self) -> int:
        return self._rings.sample_count

    def append(self, batch: ColumnBatch) -> None:
        self._rings.append(batch.columns)
        if len(batch.bad_frame_ns):
            self._bad_ns.append(batch.bad_frame_ns)
        for change in batch.e2e_changes:
            changes = self._e2e.setdefault(change.message, [])
            if changes and changes[-1].t_ns == change.t_ns:  # taken back
                changes.pop()
            changes.append(change)
        self.watermark_ns = max(self.watermark_ns, batch.watermark_ns)

    def samples(self, signal: Signal, start_ns: int, stop_ns: int) -> Series:
        """Return the samples of one signal with ``start_ns <= t_ns < stop_ns``; valid until more are appended."""
        return self._rings.between(signal, start_ns, stop_ns)

    def ahead(self, signal: Signal, until_ns: int) -> Series:
        """Return the samples of a signal that the tracker has not walked yet; valid until more are appended."""
        return self._rings.between(signal, self.walked_ns, until_ns)

    def has_change_ahead(self, signal: Signal) -> bool:
        """Return whether a sample that the tracker has not walked yet differs from the one before it."""
        return self._rings.changed_ns(signal) >= self.walked_ns

    def cut(self, start_ns: int, stop_ns: int) -> Columns:
        """Return the samples of all signals with ``start_ns <= t_ns < stop_ns``, each with the cycle that it keeps."""
        found = sorted(self._rings.cut(start_ns, stop_ns).items())
        return {
            signal: series if (own := own_period_ns(series)) == series.period_ns else replace(series, period_ns=own)
            for signal, series in found
        }

    def bad_frame_count(self, start_ns: int, stop_ns: int) -> int:
        """Return how many frames were rejected or missing in ``start_ns <= t_ns < stop_ns``."""
        return sum(int(np.count_nonzero((times >= start_ns) & (times < stop_ns))) for times in self._bad_ns)

    def e2e_states(self, start_ns: int, stop_ns: int) -> Mapping[str, E2eState]:
        """Return, by message, INVALID if it was that in ``start_ns <= t_ns < stop_ns``, else its last state there."""
        return {message: _worst(changes, start_ns, stop_ns) for message, changes in sorted(self._e2e.items())}

    def drop_before(self, keep_ns: int) -> None:
        """Forget what lies before ``keep_ns``, times of bad frames and states a little late."""
        self._rings.drop_before(keep_ns)
        if self._bad_ns:
            self._bad_ns = [times for times in self._bad_ns if times.max() >= keep_ns]
        for changes in self._e2e.values():
            while len(changes) > 1 and changes[1].t_ns <= keep_ns:
                del changes[0]

    def clear(self) -> None:
        """Forget everything: another segment of bus time begins."""
        self._rings.clear()
        self._bad_ns.clear()
        self._e2e.clear()
        self.watermark_ns = self.walked_ns = BEFORE_ALL_NS


def _worst(changes: list[E2eChange], start_ns: int, stop_ns: int) -> E2eState:
    state = E2eState.NO_DATA
    was_invalid = False
    for change in changes:
        if change.t_ns >= stop_ns:
            break
        if change.t_ns > start_ns:
            was_invalid |= state is E2eState.INVALID
        state = change.state
    return E2eState.INVALID if was_invalid else state
