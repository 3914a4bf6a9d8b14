"""How far the data of one shift can be believed, whatever friction they lead to: a score of 0 to 1, with its parts.

Every part is 1 where nothing speaks against the data and falls to 0 with the evidence; the score is their product. A
part that cannot be judged, because the bus lacks its signals, is left out. Below the least score a shift is rejected.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from canlog.e2e.e2e_state import E2eState
from canlog.jit import array_kernel
from canlog.series import Series
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Columns, Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.quality.agreement import agreement, compile_agreement
from diag_service.diagnosis.quality.limits import LIMITS, QualityLimits
from diag_service.diagnosis.records import DataQuality, QualityPart, Reason

_DAYS_PER_YEAR: Final = 365.25
_NS_PER_S: Final = 1_000_000_000
_REASONS: Final = {
    QualityPart.FRAMES: Reason.FRAMES_MISSING,
    QualityPart.PROTECTION: Reason.E2E_INVALID,
    QualityPart.TIME: Reason.TIME_UNSURE,
    QualityPart.SATURATION: Reason.SATURATED,
    QualityPart.PLAUSIBILITY: Reason.IMPLAUSIBLE,
    QualityPart.CALIBRATION: Reason.CALIBRATION_OLD,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class QualityBasis:
    """What a bus and its calibration promise, against which a shift is held."""

    mandatory_messages: frozenset[str] = frozenset()
    scale_ends: Mapping[Signal, tuple[float, float]] = field(default_factory=dict)  # least and largest value, SI
    calibration_date: date | None = None


def data_quality(event: Event, basis: QualityBasis, limits: QualityLimits = LIMITS) -> DataQuality:
    """Return how far the data of a shift can be believed."""
    numbered = _numbered(event.columns)
    judged = {
        QualityPart.FRAMES: _frames(numbered, limits),
        QualityPart.PROTECTION: _protection(event, basis.mandatory_messages, limits),
        QualityPart.TIME: _time(numbered, limits),
        QualityPart.SATURATION: _saturation(event.columns, basis.scale_ends, limits),
        QualityPart.PLAUSIBILITY: agreement(event, limits),
        QualityPart.CALIBRATION: _calibration(event.end_ns, basis.calibration_date, limits),
    }
    parts = {part: value for part, value in judged.items() if value is not None}
    return DataQuality(score=math.prod(parts.values()), parts=parts)


def reasons_against(quality: DataQuality, limits: QualityLimits = LIMITS) -> tuple[Reason, ...]:
    """Return why a shift must not be used; nothing if it may."""
    if quality.score >= limits.least_score_ratio:
        return ()
    named = tuple(_REASONS[part] for part, value in quality.parts.items() if value < limits.least_score_ratio)
    return named or (Reason.LOW_DATA_QUALITY,)


def compile_data_quality() -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    compile_agreement()
    _late_count(np.zeros(1, np.int64), np.zeros(1, np.int64), 1, 1.0)
    _share_at_ends(np.zeros(1), 0.0, 1.0)


def _numbered(columns: Columns) -> list[Series]:
    """Return the signals of the torque balance whose message counts its transmissions."""
    series = [columns[signal] for signal in BALANCE_SIGNALS if signal in columns]
    return [one for one in series if len(one.t_ns) and one.sequence[0] >= 0]


def _frames(numbered: Sequence[Series], limits: QualityLimits) -> float | None:
    """Judge the share of frames that never came or could not be used."""
    sent = sum(int(one.sequence[-1] - one.sequence[0]) + 1 for one in numbered)
    if not sent:
        return None
    return limits.lost_ratio.score(1.0 - sum(len(one.t_ns) for one in numbered) / sent)


def _protection(event: Event, mandatory: frozenset[str], limits: QualityLimits) -> float | None:
    """Judge the messages by their E2E state: one that the estimate needs and that is not valid is fatal."""
    if not mandatory and not event.e2e:
        return None
    failed = [message for message, state in event.e2e.items() if state is not E2eState.VALID]
    if not event.e2e.keys() >= mandatory or mandatory.intersection(failed):
        return 0.0
    return float(limits.optional_message_ratio ** sum(event.e2e[message] is E2eState.INVALID for message in failed))


def _time(numbered: Sequence[Series], limits: QualityLimits) -> float | None:
    """Judge how many samples came much later than the schedule that their numbers show."""
    series = [one for one in numbered if one.period_ns > 0]
    if not series:
        return None
    late = sum(_late_count(one.t_ns, one.sequence, one.period_ns, limits.late_periods) for one in series)
    return 1.0 - late / sum(len(one.t_ns) for one in series)


@array_kernel
def _late_count(t_ns: Int64Array, sequence: Int64Array, period_ns: int, late_periods: float) -> int:
    """Return how many samples came so many periods later than the schedule of the one that came earliest by it."""
    earliest_ns = t_ns[0] - sequence[0] * period_ns
    for row in range(len(t_ns)):
        earliest_ns = min(earliest_ns, t_ns[row] - sequence[row] * period_ns)
    count = 0
    for row in range(len(t_ns)):
        count += t_ns[row] - sequence[row] * period_ns - earliest_ns > late_periods * period_ns
    return count


def _saturation(
    columns: Columns, scale_ends: Mapping[Signal, tuple[float, float]], limits: QualityLimits
) -> float | None:
    """Judge how many samples lie at an end of their scale; zero is no end: that is where sensors rest."""
    shares = [
        _share_at_ends(columns[signal].value, *scale_ends[signal])
        for signal in BALANCE_SIGNALS
        if signal in scale_ends and signal in columns and len(columns[signal].value)
    ]
    return limits.saturated_ratio.score(max(shares)) if shares else None


@array_kernel
def _share_at_ends(value: FloatArray, low: float, high: float) -> float:
    margin, count = 1e-6 * (high - low), 0
    for one in value:
        count += one >= high - margin or (low < 0.0 and one <= low + margin)
    return count / len(value)


def _calibration(end_ns: int, made: date | None, limits: QualityLimits) -> float | None:
    """Judge the age of a calibration that was made for this vehicle on a known day."""
    if made is None:
        return None
    day = datetime.fromtimestamp(end_ns // _NS_PER_S, tz=UTC).date()
    return limits.calibration_years.score((day - made).days / _DAYS_PER_YEAR)
