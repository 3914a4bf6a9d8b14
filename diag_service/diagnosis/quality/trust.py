"""How far the data of one shift may be trusted, whatever friction they lead to: a score of 0 to 1, with its parts.

Every part is 1 where nothing speaks against the data and falls to 0 with the evidence; the score is their product. A
part that cannot be judged, because the bus lacks its signals, is left out. Below ``MIN_TRUST`` a shift is rejected.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from canlog.e2e.e2e_state import E2eState
from canlog.series import Series
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Columns, Signal
from diag_service.diagnosis.events import ShiftEvent
from diag_service.diagnosis.records import Reason, Trust, TrustPart

MIN_TRUST: Final = 0.5
LOSS_AT_ZERO: Final = 0.08  # share of frames lost: half of it rejects the shift
OPTIONAL_MESSAGE_FACTOR: Final = 0.9  # for each message that failed, though no estimate needs it
LATE_PERIODS: Final = 3.0  # a sample this much later than its sender's schedule says little about time
SATURATED_AT_ZERO: Final = 0.1  # share of samples at the end of the scale
WHEEL_BAND: Final = (0.03, 0.13)  # rms deviation of wheel over output speed; a hard launch reaches 0.022
HUB_BAND_RAD_S: Final = (1.0, 5.0)  # mean difference of engine and hub, which a torsion damper ties together
PRESSURE_BAND_PA: Final = (0.3e5, 1.3e5)  # median difference of pressure and its lagged command
PRESSURE_LAG_NS: Final = 25_000_000
MIN_SPEED_M_S: Final = 2.0  # below this, speed sensors resolve too little for a ratio
FRESH_YEARS: Final = 5.0  # a calibration this old counts in full; after as long again it counts half
DAYS_PER_YEAR: Final = 365.25

_NS_PER_S: Final = 1_000_000_000
_WHEELS: Final = (Signal.WHEEL_FL_SPEED, Signal.WHEEL_FR_SPEED, Signal.WHEEL_RL_SPEED, Signal.WHEEL_RR_SPEED)
_PRESSURES: Final = (
    (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH1_PRESSURE_COMMAND),
    (Signal.CLUTCH2_PRESSURE, Signal.CLUTCH2_PRESSURE_COMMAND),
)
_REASONS: Final = {
    TrustPart.FRAMES: Reason.FRAMES_MISSING,
    TrustPart.PROTECTION: Reason.E2E_INVALID,
    TrustPart.TIME: Reason.TIME_UNSURE,
    TrustPart.SATURATION: Reason.SATURATED,
    TrustPart.PLAUSIBILITY: Reason.IMPLAUSIBLE,
    TrustPart.CALIBRATION: Reason.CALIBRATION_OLD,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class TrustBasis:
    """What a bus and its calibration promise, against which a shift is held."""

    mandatory_messages: frozenset[str] = frozenset()
    limits: Mapping[Signal, tuple[float, float]] = field(default_factory=dict)  # ends of the scale, SI
    calibration_date: date | None = None


def assess(event: ShiftEvent, basis: TrustBasis) -> Trust:
    """Return how far the data of a shift may be trusted."""
    judged = {
        TrustPart.FRAMES: _frames(event.columns),
        TrustPart.PROTECTION: _protection(event, basis.mandatory_messages),
        TrustPart.TIME: _time(event.columns),
        TrustPart.SATURATION: _saturation(event.columns, basis.limits),
        TrustPart.PLAUSIBILITY: _plausibility(event.columns),
        TrustPart.CALIBRATION: _calibration(event.end_ns, basis.calibration_date),
    }
    parts = {part: value for part, value in judged.items() if value is not None}
    return Trust(score=math.prod(parts.values()), parts=parts)


def reasons_against(trust: Trust) -> tuple[Reason, ...]:
    """Return why a shift must not be used; nothing if it may."""
    if trust.score >= MIN_TRUST:
        return ()
    named = tuple(_REASONS[part] for part, value in trust.parts.items() if value < MIN_TRUST)
    return named or (Reason.LOW_TRUST,)


def _falling(value: float, start: float, end: float) -> float:
    """Return 1 up to ``start``, 0 from ``end`` on, and a straight line between."""
    return min(1.0, max(0.0, (end - value) / (end - start)))


def _numbered(columns: Columns) -> list[Series]:
    """Return the signals of the torque balance whose message counts its transmissions."""
    series = [columns[signal] for signal in BALANCE_SIGNALS if signal in columns]
    return [one for one in series if len(one.t_ns) and one.sequence[0] >= 0]


def _frames(columns: Columns) -> float | None:
    """Judge the share of frames that never came or could not be used."""
    series = _numbered(columns)
    sent = sum(int(one.sequence[-1] - one.sequence[0]) + 1 for one in series)
    if not sent:
        return None
    return _falling(1.0 - sum(len(one.t_ns) for one in series) / sent, 0.0, LOSS_AT_ZERO)


def _protection(event: ShiftEvent, mandatory: frozenset[str]) -> float | None:
    """Judge the messages by their E2E state: one that the estimate needs and that is not valid is fatal."""
    states = {**dict.fromkeys(mandatory, E2eState.NO_DATA), **event.e2e}
    if not states:
        return None
    failed = [message for message, state in states.items() if state is not E2eState.VALID]
    if mandatory.intersection(failed):
        return 0.0
    return float(OPTIONAL_MESSAGE_FACTOR ** sum(states[message] is E2eState.INVALID for message in failed))


def _time(columns: Columns) -> float | None:
    """Judge how many samples came much later than the schedule that their numbers show."""
    series = [one for one in _numbered(columns) if one.period_ns > 0]
    if not series:
        return None
    late, total = 0, 0
    for one in series:
        delay_ns = (one.t_ns - one.t_ns[0]) - (one.sequence - one.sequence[0]) * one.period_ns
        late += int(np.count_nonzero(delay_ns - delay_ns.min() > LATE_PERIODS * one.period_ns))
        total += len(one.t_ns)
    return 1.0 - late / total


def _saturation(columns: Columns, limits: Mapping[Signal, tuple[float, float]]) -> float | None:
    """Judge how many samples lie at an end of their scale; zero is no end: that is where sensors rest."""
    worst: float | None = None
    for signal in BALANCE_SIGNALS:
        if signal in limits and signal in columns and len(columns[signal].value):
            low, high = limits[signal]
            value = columns[signal].value
            margin = 1e-6 * (high - low)
            is_at_end = (value >= high - margin) | ((value <= low + margin) & (low < 0.0))
            worst = max(worst or 0.0, float(np.mean(is_at_end)))
    return None if worst is None else _falling(worst, 0.0, SATURATED_AT_ZERO)


def _plausibility(columns: Columns) -> float | None:
    """Judge sensors by others that must agree with them; the worst pair counts."""
    checks: tuple[Callable[[Columns], float | None], ...] = (_wheels, _hub, _pressures)
    judged = [value for value in (check(columns) for check in checks) if value is not None]
    return min(judged, default=None)


def _wheels(columns: Columns) -> float | None:
    """Compare wheel speeds with the speed of the transmission output: their ratio is one number."""
    output = columns.get(Signal.OUTPUT_SPEED)
    wheels = [columns[signal] for signal in _WHEELS if signal in columns]
    if output is None or not len(output.t_ns):
        return None
    ratios = [
        wheel.value[is_fast] / turning[is_fast]
        for wheel in wheels
        for turning in (_at(output, wheel),)
        for is_fast in ((wheel.value > MIN_SPEED_M_S) & (turning > 0.0),)
        if is_fast.any()
    ]
    if not ratios:
        return None
    middle = float(np.median(np.concatenate(ratios)))
    return _falling(max(float(np.sqrt(np.mean((ratio / middle - 1.0) ** 2))) for ratio in ratios), *WHEEL_BAND)


def _hub(columns: Columns) -> float | None:
    """Compare engine and clutch hub."""
    engine, hub = columns.get(Signal.ENGINE_SPEED), columns.get(Signal.HUB_SPEED)
    if engine is None or hub is None or not len(engine.t_ns) or not len(hub.t_ns):
        return None
    return _falling(abs(float(np.mean(engine.value - _at(hub, engine)))), *HUB_BAND_RAD_S)


def _pressures(columns: Columns) -> float | None:
    """Compare clutch pressures with what was commanded a moment before."""
    differences_pa = [
        float(np.median(np.abs(pressure.value - _at(command, pressure, PRESSURE_LAG_NS))))
        for read, commanded in _PRESSURES
        for pressure, command in ((columns.get(read), columns.get(commanded)),)
        if pressure is not None and command is not None and len(pressure.t_ns) and len(command.t_ns)
    ]
    return _falling(max(differences_pa), *PRESSURE_BAND_PA) if differences_pa else None


def _at(series: Series, other: Series, lag_ns: int = 0) -> FloatArray:
    """Return one signal at the times of another, or ``lag_ns`` before them."""
    origin_ns = int(series.t_ns[0])
    asked = (other.t_ns - origin_ns - lag_ns).astype(np.float64)
    return np.interp(asked, (series.t_ns - origin_ns).astype(np.float64), series.value)


def _calibration(end_ns: int, made: date | None) -> float | None:
    """Judge the age of a calibration that was made for this vehicle on a known day."""
    if made is None:
        return None
    day = datetime.fromtimestamp(end_ns // _NS_PER_S, tz=UTC).date()
    years = (day - made).days / DAYS_PER_YEAR
    return _falling(years, FRESH_YEARS, 3.0 * FRESH_YEARS)
