"""Sample instants and the even grid on which a shift is followed."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from canlog.jit import kernel
from canlog.series import Series

NS_TO_S = 1e-9
GRID_S = 1e-3  # ten points per CAN sample: quadrature error far below sensor noise
END_COUNT = 30  # samples, of which one is nearly on time; a shift is cut that much wider than its slip window


def sample_times_s(series: Series, origin_ns: int) -> FloatArray:
    """Return when the samples were taken [s] after ``origin_ns``, shape (n,), freed of transmission jitter.

    A sender with a schedule sends transmission k at ``t_0 + k * period``, and a bus only ever delays. So ``t_0`` is the
    earliest that any sample of the shift allows, however late the others came. The receive times stand where the
    message has no counter, or the sender did not keep to one schedule: then no sample near one end of the shift comes
    within a period of it.
    """
    times_s: FloatArray = (series.t_ns - origin_ns) * np.float64(NS_TO_S)
    if series.period_ns <= 0 or len(times_s) == 0 or series.sequence[0] < 0:
        return times_s
    period_s = series.period_ns * NS_TO_S
    scheduled_s: FloatArray = (series.sequence - series.sequence[0]) * np.float64(period_s)
    delays_s = times_s - scheduled_s
    earliest_s = float(delays_s.min())
    ends_s = (float(delays_s[:END_COUNT].min()), float(delays_s[-END_COUNT:].min()))
    if max(ends_s) - earliest_s > period_s:
        return times_s
    return scheduled_s + earliest_s


def segment_centres_s(times_s: FloatArray, speed_rad_s: FloatArray, segment_rad: float) -> FloatArray:
    """Return the instants to which mean speeds over the last crank segment belong: half a segment earlier."""
    centres_s: FloatArray = times_s - 0.5 * segment_rad / np.maximum(speed_rad_s, 1.0)
    return centres_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Interpolation:
    """Linear interpolation from sample times to a grid, constant beyond both ends, and its transpose.

    Grid point j reads ``(1 - share[j]) * value[left[j]] + share[j] * value[left[j] + 1]``.
    """

    left: Int64Array  # (len(grid),)
    share: FloatArray  # (len(grid),)
    sample_count: int

    @classmethod
    def between(cls, times_s: FloatArray, grid_s: FloatArray) -> Self:
        """Prepare the way from ``times_s`` (two or more, strictly increasing) to ``grid_s``."""
        left = np.clip(np.searchsorted(times_s, grid_s, side="right") - 1, 0, len(times_s) - 2)
        share = np.clip((grid_s - times_s[left]) / (times_s[left + 1] - times_s[left]), 0.0, 1.0)
        return cls(left=left, share=share, sample_count=len(times_s))

    def to_grid(self, value: FloatArray) -> FloatArray:
        """Return the samples' values on the grid, shape (len(grid),)."""
        on_grid: FloatArray = (1.0 - self.share) * value[self.left] + self.share * value[self.left + 1]
        return on_grid

    def to_samples(self, weights: FloatArray) -> FloatArray:
        """Return the weight of each sample, shape (k, n), in k weighted sums over the grid, shape (k, len(grid))."""
        spread = np.zeros((len(weights), self.sample_count))
        _spread(weights, self.left, self.share, spread)
        return spread


@kernel
def _spread(weights: FloatArray, left: Int64Array, share: FloatArray, spread: FloatArray) -> None:
    for k in range(weights.shape[0]):
        for j in range(weights.shape[1]):
            spread[k, left[j]] += weights[k, j] * (1.0 - share[j])
            spread[k, left[j] + 1] += weights[k, j] * share[j]
