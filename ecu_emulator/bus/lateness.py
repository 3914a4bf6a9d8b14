"""How punctual a transmission was: lateness as a histogram, drift as a slope, in constant memory."""

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from canlog.arrays import Int64Array

BIN_S: Final = 10e-6
BINS: Final = 50_000  # up to half a second; what is later counts in the last bin
PPM: Final = 1e6


class Punctuality:
    """Lateness of frames against their deadlines, one value per frame."""

    def __init__(self, overrun_s: float) -> None:
        self._overrun_s = overrun_s
        self._histogram: Int64Array = np.zeros(BINS, np.int64)
        self._count = 0
        self._sum_t = self._sum_late = self._sum_t_t = self._sum_t_late = 0.0
        self._max_s = 0.0
        self._overruns = 0

    def add(self, due_s: float, lateness_s: float) -> None:
        """Count a frame that was due at ``due_s`` of the schedule and began to be sent this much later."""
        self._histogram[min(int(max(lateness_s, 0.0) / BIN_S), BINS - 1)] += 1
        self._count += 1
        self._sum_t += due_s
        self._sum_late += lateness_s
        self._sum_t_t += due_s * due_s
        self._sum_t_late += due_s * lateness_s
        self._max_s = max(self._max_s, lateness_s)
        if lateness_s > self._overrun_s:
            self._overruns += 1

    @property
    def overruns(self) -> int:
        """Frames that were later than what counts as on time."""
        return self._overruns

    @property
    def max_s(self) -> float:
        """Return the greatest lateness."""
        return self._max_s

    @property
    def mean_s(self) -> float:
        """Return the mean lateness, 0 without frames."""
        return self._sum_late / self._count if self._count else 0.0

    def quantile_s(self, fraction: float) -> float:
        """Return the lateness that this fraction of the frames did not exceed, rounded up to 10 microseconds."""
        if self._count == 0:
            return 0.0
        place = int(np.searchsorted(np.cumsum(self._histogram), fraction * self._count))
        return min((place + 1) * BIN_S, self._max_s)

    @property
    def drift_ppm(self) -> float:
        """Return by how much the sent schedule runs slow: the slope of lateness over time, least squares."""
        spread = self._count * self._sum_t_t - self._sum_t * self._sum_t
        if spread <= 0.0:
            return 0.0
        return (self._count * self._sum_t_late - self._sum_t * self._sum_late) / spread * PPM
