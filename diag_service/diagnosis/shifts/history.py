"""The recent past of a stream of column batches: what the finders of events look back on, with bounded memory."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from canlog.arrays import Series
from canlog.e2e.alive_counter import compile_now, own_period_ns
from canlog.e2e.e2e_state import E2eChange, E2eState
from canlog.frames import BEFORE_ALL_NS
from diag_service.diagnosis.columns import ColumnBatch, Columns, Signal
from diag_service.diagnosis.shifts.sample_rings import SampleRings

if TYPE_CHECKING:
    from canlog.arrays import Int64Array


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
            self._e2e.setdefault(change.message, []).append(change)
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
        return {signal: _at_own_cycle(series) for signal, series in found}

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


def _at_own_cycle(series: Series) -> Series:
    own_ns = own_period_ns(series)
    return series if own_ns == series.period_ns else replace(series, period_ns=own_ns)


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
