"""Whether the signals of an event can be put on one clock at all, and if so, those signals."""

from dataclasses import dataclass

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import array_kernel
from clutch_model.calibration import Calibration
from diag_service.diagnosis.alignment import (
    NS_TO_S,
    AlignedSignals,
    SampleTimes,
    align,
    measured_times,
    sampling_times,
)
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Signal
from diag_service.diagnosis.events import EndReason, Event
from diag_service.diagnosis.quality.averages import mean
from diag_service.diagnosis.quality.limits import LIMITS, QualityLimits
from diag_service.diagnosis.records import Reason


@dataclass(frozen=True, slots=True, kw_only=True)
class Samples:
    """What was sampled in an event that can be used, whatever vehicle it is of."""

    event: Event
    times: SampleTimes
    oil_k: float


def usable_signals(event: Event, calibration: Calibration, limits: QualityLimits = LIMITS) -> AlignedSignals | Reason:
    """Return the signals of a shift or engine run-up on one clock, or why they cannot be used."""
    samples = usable_samples(event, limits)
    return samples if isinstance(samples, Reason) else aligned(samples, calibration, limits=limits)


def usable_samples(event: Event, limits: QualityLimits = LIMITS) -> Samples | Reason:
    """Return the samples of a shift or engine run-up, or why they cannot be used."""
    if event.end_reason not in {EndReason.COMPLETE, EndReason.ABANDONED}:
        return Reason.INTERRUPTED
    is_whole = event.end_reason is EndReason.COMPLETE  # what another event cut short may be seen in full, or not
    oil = event.columns.get(Signal.SUMP_TEMPERATURE)
    sampled = sampling_times(event)
    if oil is None or not len(oil.t_ns) or len(sampled) < len(BALANCE_SIGNALS):
        return Reason.SIGNAL_MISSING if is_whole else Reason.INTERRUPTED
    duration_s = (event.end_ns - event.start_ns) * NS_TO_S
    if any(is_lost(times_s, event.columns[one].period_ns, duration_s, limits) for one, times_s in sampled.items()):
        return Reason.FRAMES_MISSING if is_whole else Reason.INTERRUPTED
    oil_k = mean(oil.value)
    if not limits.oil_range_k[0] <= oil_k <= limits.oil_range_k[1]:
        return Reason.OUT_OF_RANGE
    return Samples(event=event, times=sampled, oil_k=oil_k)


def aligned(
    samples: Samples, calibration: Calibration, other: AlignedSignals | None = None, *, limits: QualityLimits = LIMITS
) -> AlignedSignals | Reason:
    """Return samples on one clock, latencies as a calibration has them, or why they cannot be.

    What no calibration moves is taken over from ``other``: the same samples as another calibration has them.
    """
    times = measured_times(samples.times, samples.event, calibration)
    if min(_step_range_s(one)[0] for one in times.values()) <= 0.0:
        return Reason.OUT_OF_RANGE  # time runs backwards inside a segment: the receive clock cannot be believed
    return align(times, samples.event, samples.oil_k, gaps_s(times, samples.event, limits), other)


def is_lost(times_s: FloatArray, period_ns: int, duration_s: float, limits: QualityLimits = LIMITS) -> bool:
    """Return whether too many samples in a row are missing between the event's start and its end; late ones are not."""
    period_s = _period_s(period_ns, limits)
    return _longest_silence_s(times_s, -2.0 * period_s, duration_s) > limits.lost_periods * period_s


@array_kernel
def _longest_silence_s(times_s: FloatArray, from_s: float, duration_s: float) -> float:
    """Return for how long [s] nothing was sampled between the event's start and its end; inf for fewer than 2 samples.

    Samples before the start count from ``from_s`` on.
    """
    count, longest_s, latest_s = 0, 0.0, 0.0
    for time_s in times_s:
        if from_s <= time_s <= duration_s:
            since_s = latest_s if count else min(0.0, time_s)
            count, longest_s, latest_s = count + 1, max(longest_s, time_s - since_s), time_s
    return max(longest_s, duration_s - latest_s) if count > 1 else np.inf


def gaps_s(times: SampleTimes, event: Event, limits: QualityLimits = LIMITS) -> FloatArray:
    """Return between which instants [s] two samples of any signal or more are missing in a row, shape (n, 2)."""
    duration_s = (event.end_ns - event.start_ns) * NS_TO_S
    found = []
    for signal, times_s in times.items():
        longest_s = limits.gap_periods * _period_s(event.columns[signal].period_ns, limits)
        if _step_range_s(times_s)[1] > longest_s:
            found += [times_s[row : row + 2] for row in np.flatnonzero(np.diff(times_s) > longest_s)]
        if duration_s - times_s[-1] > longest_s:
            found.append(np.array((times_s[-1], duration_s)))
    return np.array(found).reshape(-1, 2)


@array_kernel
def _step_range_s(times_s: FloatArray) -> tuple[float, float]:
    """Return the least and the longest time [s] from one sample to the next; inf and -inf if there is only one."""
    least_s, longest_s = np.inf, -np.inf
    for row in range(1, len(times_s)):
        step_s = times_s[row] - times_s[row - 1]
        least_s, longest_s = min(least_s, step_s), max(longest_s, step_s)
    return least_s, longest_s


def compile_usability() -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    _longest_silence_s(np.zeros(2), 0.0, 0.0)
    _step_range_s(np.zeros(2))


def _period_s(period_ns: int, limits: QualityLimits) -> float:
    """Return the period of a signal, the nominal one where its message states none."""
    return period_ns * NS_TO_S or limits.nominal_period_s
