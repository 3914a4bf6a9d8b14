"""How events are found: a tracker walks along the samples and says when they begin and end, a finder cuts them out."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Final, Protocol

import numpy as np

from canlog.arrays import FloatArray, Int64Array, Series
from canlog.e2e.alive_counter import came_in_bursts
from canlog.frames import BEFORE_ALL_NS
from clutch_results.event_kinds import EndReason, EventKind
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.shifts.history import History

NS_PER_S = 1_000_000_000
_NEVER: Final = np.empty(0, np.int64)
_AFTER_A_REST = frozenset({EventKind.LAUNCH, EventKind.CREEP})


@dataclass(frozen=True, slots=True)
class Bounds:
    """When an event began and ended, and between which gears; 0 is neutral."""

    from_gear: int
    to_gear: int
    start_ns: int
    end_ns: int
    end_reason: EndReason
    kind: EventKind = EventKind.SHIFT


class Tracker(Protocol):
    """Finds where events begin and end, in steps of any size."""

    def track(self, history: History, until_ns: int) -> list[Bounds]:
        """Walk the samples ahead with ``t < until_ns``; return the events that ended."""

    def interrupt(self, history: History, now_ns: int) -> list[Bounds]:
        """End the stretch: return the event that is open, as interrupted, and forget everything."""

    @property
    def open_ns(self) -> int | None:
        """When the open event began, if there is one."""


class EventFinder:
    """Finds events in a stream of column batches with bounded memory, the same ones for any cutting of the stream.

    Where an event begins and ends its tracker says. It is reported once bus time has passed ``after_ns`` beyond its
    end, cut from ``before_ns`` before it; a launch or creep from ``rest_ns`` before it, but no further than to the end
    of the event before: so long the car may have rested, with both clutches open.
    """

    def __init__(self, tracker: Tracker, before_ns: int, after_ns: int, rest_ns: int = 0) -> None:
        self._tracker = tracker
        self._before_ns = before_ns
        self._rest_ns = max(rest_ns, before_ns)
        self._end_ns = BEFORE_ALL_NS  # of the event before
        self._after_ns = after_ns
        self._history = History()
        self._closed: list[Bounds] = []
        self._event_count = 0

    def feed(self, batch: ColumnBatch) -> list[Event]:
        """Append the next columns and return the events that are now known in full, oldest first."""
        events = self.flush() if batch.breaks_before else []
        self._history.append(batch)
        self._track(self._history.watermark_ns)
        while (due_ns := self.due_ns) is not None and due_ns < self._history.watermark_ns:
            events.append(self._cut(self._closed.pop(0)))
        starts = [bounds.start_ns for bounds in self._closed]
        if self._tracker.open_ns is not None:
            starts.append(self._tracker.open_ns)
        self._history.drop_before(min([*starts, self._history.watermark_ns]) - self._rest_ns)
        return events

    def flush(self) -> list[Event]:
        """End the segment: report what is closed, and the open event as interrupted."""
        self._track(self._history.watermark_ns + 1)
        self._closed += self._tracker.interrupt(self._history, self._history.watermark_ns)
        events = [self._cut(bounds) for bounds in self._closed]
        self._history.clear()
        self._closed.clear()
        self._end_ns = BEFORE_ALL_NS
        return events

    @property
    def is_expecting(self) -> bool:
        """Whether an event has begun that was not reported yet."""
        return bool(self._closed) or self._tracker.open_ns is not None

    @property
    def due_ns(self) -> int | None:
        """Bus time beyond which the oldest event that has ended will be reported, if there is one."""
        return self._closed[0].end_ns + self._after_ns if self._closed else None

    @property
    def buffered_sample_count(self) -> int:
        """Samples held of all signals: bounded by the longest event, whatever the length of the drive."""
        return self._history.sample_count

    def _track(self, until_ns: int) -> None:
        """Walk the samples with ``t < until_ns``: at the watermark itself one may still be on its way."""
        self._closed += self._tracker.track(self._history, until_ns)
        self._history.walked_ns = until_ns

    def _cut(self, bounds: Bounds) -> Event:
        first_ns, stop_ns = bounds.start_ns - self._before_ns, bounds.end_ns + self._after_ns
        if bounds.kind in _AFTER_A_REST:
            first_ns = min(first_ns, max(bounds.start_ns - self._rest_ns, self._end_ns))
        self._end_ns = bounds.end_ns
        self._event_count += 1
        columns = self._history.cut(first_ns, stop_ns)
        return Event(
            kind=bounds.kind,
            number=self._event_count,
            from_gear=bounds.from_gear,
            to_gear=bounds.to_gear,
            start_ns=bounds.start_ns,
            end_ns=max(bounds.end_ns, bounds.start_ns + 1),
            end_reason=bounds.end_reason,
            columns=columns,
            bad_frame_count=self._history.bad_frame_count(first_ns, stop_ns),
            e2e=self._history.e2e_states(first_ns, stop_ns),
            came_late=came_in_bursts(columns.values()),
        )


class HeldSignals:
    """Some signals at all times at which one of them has a sample, each at its latest value; NaN before its first."""

    def __init__(self, signals: tuple[Signal, ...]) -> None:
        self._last = dict.fromkeys(signals, np.nan)

    def ahead(self, history: History, until_ns: int) -> tuple[Int64Array, Mapping[Signal, FloatArray]]:
        """Return times and values of what has not been walked yet, shape (n,) each."""
        series = {signal: history.ahead(signal, until_ns) for signal in self._last}
        t_ns = reduce(np.union1d, (one.t_ns for one in series.values()), _NEVER)
        values = {signal: held_values(one, t_ns, self._last[signal]) for signal, one in series.items()}
        if len(t_ns):
            self._last = {signal: float(value[-1]) for signal, value in values.items()}
        return t_ns, values

    def forget(self) -> None:
        self._last = dict.fromkeys(self._last, np.nan)


def held_values(series: Series, t_ns: Int64Array, before: float) -> FloatArray:
    """Return the value in force at each time: the latest sample, or the one known ``before`` the first."""
    samples = series.t_ns.searchsorted(t_ns, "right")
    return np.concatenate([[before], series.value])[samples]
