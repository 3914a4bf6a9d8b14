"""How far the data of one shift can be believed, whatever friction they lead to: a score of 0 to 1, with its parts.

Every part is 1 where nothing speaks against the data and falls to 0 with the evidence; the score is their product. A
part that cannot be judged, because the bus lacks its signals, is left out. Below the least score a shift is rejected.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from typing import Final

import numpy as np

from canlog.e2e.e2e_state import E2eState
from canlog.series import Series
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Columns, Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.quality.limits import LIMITS, QualityLimits
from diag_service.diagnosis.quality.plausibility import agreement
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
    judged = {
        QualityPart.FRAMES: _frames(event.columns, limits),
        QualityPart.PROTECTION: _protection(event, basis.mandatory_messages, limits),
        QualityPart.TIME: _time(event.columns, limits),
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


def _numbered(columns: Columns) -> list[Series]:
    """Return the signals of the torque balance whose message counts its transmissions."""
    series = [columns[signal] for signal in BALANCE_SIGNALS if signal in columns]
    return [one for one in series if len(one.t_ns) and one.sequence[0] >= 0]


def _frames(columns: Columns, limits: QualityLimits) -> float | None:
    """Judge the share of frames that never came or could not be used."""
    series = _numbered(columns)
    sent = sum(int(one.sequence[-1] - one.sequence[0]) + 1 for one in series)
    if not sent:
        return None
    return limits.lost_ratio.score(1.0 - sum(len(one.t_ns) for one in series) / sent)


def _protection(event: Event, mandatory: frozenset[str], limits: QualityLimits) -> float | None:
    """Judge the messages by their E2E state: one that the estimate needs and that is not valid is fatal."""
    states = {**dict.fromkeys(mandatory, E2eState.NO_DATA), **event.e2e}
    if not states:
        return None
    failed = [message for message, state in states.items() if state is not E2eState.VALID]
    if mandatory.intersection(failed):
        return 0.0
    return float(limits.optional_message_ratio ** sum(states[message] is E2eState.INVALID for message in failed))


def _time(columns: Columns, limits: QualityLimits) -> float | None:
    """Judge how many samples came much later than the schedule that their numbers show."""
    series = [one for one in _numbered(columns) if one.period_ns > 0]
    if not series:
        return None
    late, total = 0, 0
    for one in series:
        delay_ns = (one.t_ns - one.t_ns[0]) - (one.sequence - one.sequence[0]) * one.period_ns
        late += int(np.count_nonzero(delay_ns - delay_ns.min() > limits.late_periods * one.period_ns))
        total += len(one.t_ns)
    return 1.0 - late / total


def _saturation(
    columns: Columns, scale_ends: Mapping[Signal, tuple[float, float]], limits: QualityLimits
) -> float | None:
    """Judge how many samples lie at an end of their scale; zero is no end: that is where sensors rest."""
    worst: float | None = None
    for signal in BALANCE_SIGNALS:
        if signal in scale_ends and signal in columns and len(columns[signal].value):
            low, high = scale_ends[signal]
            value = columns[signal].value
            margin = 1e-6 * (high - low)
            is_at_end = (value >= high - margin) | ((value <= low + margin) & (low < 0.0))
            worst = max(worst or 0.0, float(np.mean(is_at_end)))
    return None if worst is None else limits.saturated_ratio.score(worst)


def _calibration(end_ns: int, made: date | None, limits: QualityLimits) -> float | None:
    """Judge the age of a calibration that was made for this vehicle on a known day."""
    if made is None:
        return None
    day = datetime.fromtimestamp(end_ns // _NS_PER_S, tz=UTC).date()
    return limits.calibration_years.score((day - made).days / _DAYS_PER_YEAR)
