"""Readings made wrong as a scenario scripts it; pure, and the same however the drive was cut."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario.faults import PhaseCode, Scheduled, SensorFault, SensorFaultKind

MS_PER_S: Final = 1000.0


class Onsets:
    """Begin and end of each scheduled thing in milliseconds of scenario time; infinite while not known."""

    def __init__(self, scheduled: Sequence[Scheduled]) -> None:
        self._scheduled: list[Scheduled] = []
        self._start_ms: list[float] = []
        for one in scheduled:
            self.add(one)
        self._phase = int(PhaseCode.HOLD)
        self._shift_count = 0

    def add(self, one: Scheduled, origin_ms: float = 0.0) -> None:
        """Schedule one more; without a shift its start counts from ``origin_ms``."""
        self._scheduled.append(one)
        self._start_ms.append(math.inf if one.shift else origin_ms + math.ceil(one.start_s * MS_PER_S))

    def feed(self, rows: FloatArray, first_ms: int) -> None:
        """Look for the phases of shifts in the next plant rows, one per millisecond."""
        phases = rows[:, Col.SHIFT_PHASE].astype(np.int64)
        for row in np.flatnonzero(np.diff(phases, prepend=self._phase)).tolist():
            self._phase = int(phases[row])
            self._shift_count += self._phase == PhaseCode.PREFILL
            for index, one in enumerate(self._scheduled):
                if one.shift == self._shift_count and self._phase == PhaseCode[one.phase.name]:
                    self._start_ms[index] = first_ms + row + math.ceil(one.start_s * MS_PER_S)

    def span_ms(self, index: int) -> tuple[float, float]:
        """Return begin and end [ms] of one of them; what is at the end is outside."""
        start_ms = self._start_ms[index]
        return start_ms, start_ms + self._scheduled[index].duration_s * MS_PER_S


@dataclass(slots=True)
class _Progress:
    """How far one fault has come."""

    held: float = math.nan  # last reading before it
    changed_count: int = 0


class SensorFaults:
    """All scripted sensor faults of a drive."""

    def __init__(self, faults: Sequence[SensorFault]) -> None:
        self._faults: list[SensorFault] = []
        self._progress: list[_Progress] = []
        self._onsets = Onsets(())
        for fault in faults:
            self.add(fault)

    @property
    def faults(self) -> tuple[SensorFault, ...]:
        """All faults asked for."""
        return tuple(self._faults)

    def add(self, fault: SensorFault, origin_s: float = 0.0) -> None:
        """Take one more fault; without a shift its start counts from ``origin_s``."""
        self._faults.append(fault)
        self._progress.append(_Progress())
        self._onsets.add(fault, origin_s * MS_PER_S)

    @property
    def changed_counts(self) -> tuple[int, ...]:
        """How many readings each fault has touched."""
        return tuple(progress.changed_count for progress in self._progress)

    @property
    def spans_s(self) -> tuple[tuple[float, float], ...]:
        """Begin and end [s] of each fault, infinite while not known."""
        spans_ms = map(self._onsets.span_ms, range(len(self._faults)))
        return tuple((start_ms / MS_PER_S, stop_ms / MS_PER_S) for start_ms, stop_ms in spans_ms)

    def feed(self, rows: FloatArray, first_ms: int) -> None:
        """Take the next plant rows, in which faults may be triggered."""
        self._onsets.feed(rows, first_ms)

    def applied(self, quantity: str, send_ms: npt.NDArray[np.int64], reading: FloatArray) -> FloatArray:
        """Return the readings of one quantity at these instants, shape (n,), as the faults leave them."""
        for index, fault in enumerate(self._faults):
            if fault.quantity == quantity and len(reading):
                reading = self._wrong(index, send_ms, reading)
        return reading

    def _wrong(self, index: int, send_ms: npt.NDArray[np.int64], reading: FloatArray) -> FloatArray:
        fault, progress = self._faults[index], self._progress[index]
        start_ms, stop_ms = self._onsets.span_ms(index)
        first, stop = np.searchsorted(send_ms, (start_ms, stop_ms)).tolist()
        if first:
            progress.held = float(reading[first - 1])
        if fault.kind is SensorFaultKind.SPIKE:
            stop = min(stop, first + (progress.changed_count == 0))
        if first >= stop:
            return reading
        wrong = reading.copy()
        match fault.kind:
            case SensorFaultKind.FROZEN:
                progress.held = float(reading[first]) if math.isnan(progress.held) else progress.held
                wrong[first:stop] = progress.held
            case SensorFaultKind.OFFSET | SensorFaultKind.SPIKE:
                wrong[first:stop] += fault.size
            case SensorFaultKind.DRIFT:
                wrong[first:stop] += fault.size * (send_ms[first:stop] - start_ms) / MS_PER_S
            case SensorFaultKind.NOT_AVAILABLE:
                wrong[first:stop] = math.nan
        progress.changed_count += stop - first
        return wrong
