"""Whether the signals of a shift can be put on one clock at all, and if so, those signals."""

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration
from diag_service.diagnosis.alignment import NS_TO_S, AlignedSignals, align, measured_times, sampling_times
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Signal
from diag_service.diagnosis.events import EndReason, Event
from diag_service.diagnosis.quality.limits import LIMITS, QualityLimits
from diag_service.diagnosis.records import Reason


def usable_signals(event: Event, calibration: Calibration, limits: QualityLimits = LIMITS) -> AlignedSignals | Reason:
    """Return the signals of a shift or engine run-up on one clock, or why they cannot be used."""
    if event.end_reason is not EndReason.COMPLETE:
        return Reason.INTERRUPTED
    oil = event.columns.get(Signal.SUMP_TEMPERATURE)
    sampled = sampling_times(event)
    if oil is None or not len(oil.t_ns) or len(sampled) < len(BALANCE_SIGNALS):
        return Reason.SIGNAL_MISSING
    duration_s = (event.end_ns - event.start_ns) * NS_TO_S
    if any(has_gap(times_s, event.columns[one].period_ns, duration_s, limits) for one, times_s in sampled.items()):
        return Reason.FRAMES_MISSING
    oil_k = float(np.mean(oil.value))
    if not limits.oil_range_k[0] <= oil_k <= limits.oil_range_k[1]:
        return Reason.OUT_OF_RANGE
    times = measured_times(sampled, event, calibration)
    if any(np.any(np.diff(one) <= 0.0) for one in times.values()):
        return Reason.OUT_OF_RANGE  # time runs backwards inside a segment: the receive clock cannot be believed
    return align(times, event, oil_k)


def has_gap(times_s: FloatArray, period_ns: int, duration_s: float, limits: QualityLimits = LIMITS) -> bool:
    """Return whether two samples in a row are missing between the shift's start and its end; late ones are not."""
    period_s = period_ns * NS_TO_S or limits.nominal_period_s
    inside_s = times_s[(times_s >= -2.0 * period_s) & (times_s <= duration_s)]
    if len(inside_s) < 2:
        return True
    steps_s = np.diff(inside_s, prepend=min(0.0, float(inside_s[0])), append=max(duration_s, float(inside_s[-1])))
    return bool(steps_s.max() > limits.gap_periods * period_s)
