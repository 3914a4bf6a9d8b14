"""When scripted faults begin: drive time, or a phase of a shift, found in the plant rows as they come."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from ecu_emulator.plant.columns import Col
from ecu_emulator.scenario.faults import PhaseCode, Scheduled

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
