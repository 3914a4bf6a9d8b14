"""Sample instants and the even grid on which a shift is followed."""

import numpy as np

from diag_service.records import FloatArray, Series

NS_TO_S = 1e-9
GRID_S = 1e-3  # ten points per CAN sample: quadrature error far below sensor noise


def sample_times_s(series: Series, origin_ns: int) -> FloatArray:
    """Return when the samples were taken [s] after ``origin_ns``, shape (n,), freed of transmission jitter.

    A sender with a schedule sends transmission k at ``t_0 + k * period``, and a bus only ever delays. So ``t_0`` is the
    earliest that any sample of the shift allows. Where the delays do not fit such a schedule (their median is beyond
    one period), or the message has no counter, the receive times stand.
    """
    times_s: FloatArray = (series.t_ns - origin_ns) * np.float64(NS_TO_S)
    if series.period_ns <= 0 or len(times_s) == 0 or series.sequence[0] < 0:
        return times_s
    period_s = series.period_ns * NS_TO_S
    scheduled_s: FloatArray = (series.sequence - series.sequence[0]) * np.float64(period_s)
    delays_s = times_s - scheduled_s
    earliest_s = float(delays_s.min())
    if float(np.median(delays_s)) - earliest_s > period_s:
        return times_s
    return scheduled_s + earliest_s


def segment_centres_s(times_s: FloatArray, speed_rad_s: FloatArray, segment_rad: float) -> FloatArray:
    """Return the instants to which mean speeds over the last crank segment belong: half a segment earlier."""
    centres_s: FloatArray = times_s - 0.5 * segment_rad / np.maximum(speed_rad_s, 1.0)
    return centres_s


def interpolation_matrix(grid_s: FloatArray, times_s: FloatArray) -> FloatArray:
    """Return the (len(grid), len(times)) matrix of linear interpolation, constant beyond both ends.

    ``times_s`` must increase strictly.
    """
    right = np.clip(np.searchsorted(times_s, grid_s, side="right"), 1, len(times_s) - 1)
    left = right - 1
    share = np.clip((grid_s - times_s[left]) / (times_s[right] - times_s[left]), 0.0, 1.0)
    matrix = np.zeros((len(grid_s), len(times_s)))
    rows = np.arange(len(grid_s))
    matrix[rows, left] = 1.0 - share
    matrix[rows, right] += share
    return matrix
