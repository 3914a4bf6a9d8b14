"""How far the data of one shift can be believed, whatever friction they lead to: a score of 0 to 1, with its parts.

Every part is 1 where nothing speaks against the data and falls to 0 with the evidence; the score is their product. A
part that cannot be judged, because the bus lacks its signals, is left out. Below the least score a shift is rejected.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array, Series
from canlog.e2e.alive_counter import row_period_ns
from canlog.e2e.e2e_state import E2eState
from canlog.e2e.profile1 import COUNTER_PERIOD
from clutch_model.calibration import Calibration, TorqueSource
from clutch_results.event_kinds import SLIPS_IN_GEAR, EndReason, EventKind
from clutch_results.records import DataQuality, QualityPart, Reason
from diag_service.diagnosis.alignment import (
    ANSWER_S,
    COMMAND_LAG_S,
    FRAME_AGE_STD_S,
    NO_ROWS,
    NS_TO_S,
    AlignedSignals,
    Rows,
    SampleTimes,
    align,
    is_of_rows,
    measured_times,
    noise_of_signals,
    sampling_times,
)
from diag_service.diagnosis.columns import BALANCE_SIGNALS, ROW_SIGNALS, Columns, Signal
from diag_service.diagnosis.events import Event


@dataclass(frozen=True, slots=True, kw_only=True)
class Band:
    """From where on a flaw costs data quality, and from where on it takes all of it."""

    start: float
    end: float

    def score(self, flaw: float) -> float:
        """Return 1 up to the start of the band, 0 from its end on, and a straight line between."""
        return min(1.0, max(0.0, (self.end - flaw) / (self.end - self.start)))


@dataclass(frozen=True, slots=True, kw_only=True)
class QualityLimits:
    """Every limit on the data of a shift; each name ends in its unit."""

    # Usable: without this the signals cannot be put on one clock.
    gap_periods: float = 2.5  # one missing frame is bridged by interpolation; in a longer gap no friction is looked for
    lost_periods: float = 8.5  # a longer gap may hide anything: the event is not used
    nominal_period_s: float = 0.01  # of signals whose message states no cycle time
    row_gap_periods: float = 3.5  # as gap_periods, of the rows of a table, which come unevenly
    near_row_periods: float = 0.25  # a row that comes so soon after another tells nothing beside it
    oil_range_k: tuple[float, float] = (233.15, 443.15)  # -40..170 degC: where the fluid's viscosity law holds

    # Data quality: each part from 0 to 1, and the least product of all parts.
    least_score_ratio: float = 0.5
    lost_ratio: Band = Band(start=0.0, end=0.4)  # of frames: half of it rejects an event; gaps are left out besides
    optional_message_ratio: float = 0.9  # factor for each message that failed, though no estimate needs it
    late_periods: float = 3.0  # a sample this much later than its sender's schedule says little about time
    saturated_ratio: Band = Band(start=0.0, end=0.1)  # of samples at the end of the scale
    wheel_ratio: Band = Band(start=0.03, end=0.13)  # rms of wheel over output speed; a hard launch reaches 0.022
    least_wheel_m_s: float = 2.0  # below this, speed sensors resolve too little for a ratio
    hub_mean_rad_s: Band = Band(start=1.0, end=5.0)  # engine less hub, which a torsion damper ties together
    pressure_median_pa: Band = Band(start=0.3e5, end=1.3e5)  # pressure less its lagged command, over the whole cut
    calibration_years: Band = Band(start=5.0, end=15.0)  # age of a vehicle's own calibration

    # Plausibility: two to three times what sound signals reach.
    speeds_rad_s: float = 2.0  # between shafts that turn together; sound: 0.76, torsion of flywheel and shafts
    launch_speeds_rad_s: float = 8.0  # engine and hub in a launch, whose clutch may judder; sound: 3.7
    speeds_mean_s: float = 0.05  # five samples: noise falls by half, a fault shorter than that weighs little
    locked_s: float = 0.10  # before the shift one clutch is locked, at its end the other one
    settling_rad_s: float = 0.5  # in half of that time: so fast changes the slip of a clutch that is not locked yet
    turning_rad_s: float = 10.0  # slower, a shaft's speed sensor resolves too little for a ratio
    ringing_s: float = 0.05  # so long does a shaft swing after its synchroniser has engaged a gear
    in_gear_s: float = 0.10  # before its slip window the on-coming shaft stands in gear
    pressure_moment_pa: float = 0.20e5  # pressure of the slipping clutch less the expected one; sound: 0.10e5
    pressure_mean_s: float = 0.06  # the span of that moment
    command_clock_s: float = 0.01  # a command may be so far ahead of the speeds, to whose clock the pressures are moved
    following_ratio: float = 0.5  # of what a command is ahead of its pressure: no valve follows a jump to the letter
    travel_pa: float = 0.30e5  # so near its touch pressure a piston may still be on its way
    catching_up_s: float = 0.15  # until the pressure behind a piston that has arrived is the commanded one; sound: 0.10
    pressure_window_pa: float = 0.10e5  # the same over the whole slip window; sound: 0.05e5
    zero_gate: float = 25.0  # squared distance of a measured zero from the known one, in variances: 6e-7 by chance
    least_noise_steps: float = 0.75  # of the resolution; a ramp without noise seems to have up to 0.6
    repeats_chance: float = 1e-6  # that a sound signal repeats a value as often as one that is called frozen


LIMITS: Final = QualityLimits()


UNSCHEDULED_PERIODS: Final = 1.5  # of the nominal one: what comes more seldom without schedule was asked for
MOST_NOISES: Final = 3e4  # of its sensor: no speed, torque or pressure is larger
MOST: Final = 1e9  # SI: likewise; a signal of a bus that is a floating-point number may say anything
SHAFT_GEARS: Final = (Signal.INPUT1_GEAR, Signal.INPUT2_GEAR)
_LAG_NS: Final = round(COMMAND_LAG_S / NS_TO_S)
_NEVER: Final = np.empty(0, np.int64)
_NO_RATIO: Final = np.empty(0)
_WHEELS: Final = (Signal.WHEEL_FL_SPEED, Signal.WHEEL_FR_SPEED, Signal.WHEEL_RL_SPEED, Signal.WHEEL_RR_SPEED)
_PRESSURES: Final = (
    (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH1_PRESSURE_COMMAND),
    (Signal.CLUTCH2_PRESSURE, Signal.CLUTCH2_PRESSURE_COMMAND),
)


def agreement(event: Event, limits: QualityLimits = LIMITS) -> float | None:
    """Return how well sensors agree that must, 0 to 1; the worst pair counts, None if there is no pair."""
    columns = event.columns
    # With both clutches open nothing is asked of them, and a piston that returns holds the pressure of its spring.
    pressures = None if event.kind is EventKind.REGEAR else _pressures(columns, limits)
    judged = (_wheels(event, limits), _hub(columns, limits), pressures)
    return min((value for value in judged if value is not None), default=None)


def _wheels(event: Event, limits: QualityLimits) -> float | None:
    """Compare wheel speeds with the speed of the transmission output: their ratio is one number.

    While a shaft rings in its new gear, so does the output: that tells nothing of the sensors.
    """
    columns = event.columns
    output = columns.get(Signal.OUTPUT_SPEED)
    if output is None or not len(output.t_ns):
        return None
    gears = [columns[signal] for signal in SHAFT_GEARS if signal in columns]
    changes_ns = np.concatenate([_NEVER, *(gear.t_ns[1:][np.diff(gear.value) != 0.0] for gear in gears)])
    wheels = [columns[signal] for signal in _WHEELS if signal in columns]
    ratios = [_ratios(wheel, output, changes_ns, limits) for wheel in wheels]
    found = np.concatenate([_NO_RATIO, *ratios])
    if not len(found):
        return None
    middle = np.median(found)
    return limits.wheel_ratio.score(max(math.sqrt(np.mean((own / middle - 1.0) ** 2)) for own in ratios if len(own)))


def _ratios(wheel: Series, output: Series, changes_ns: Int64Array, limits: QualityLimits) -> FloatArray:
    """Return a wheel's speed over that of the output where both turn and no shaft rings."""
    turning_rad_s = _reading(output, wheel.t_ns)
    is_told = (wheel.value > limits.least_wheel_m_s) & (turning_rad_s > 0.0)
    for change_ns in changes_ns:
        is_told &= np.abs(wheel.t_ns - change_ns) * NS_TO_S > limits.ringing_s
    return np.asarray(wheel.value[is_told] / turning_rad_s[is_told])


def _hub(columns: Columns, limits: QualityLimits) -> float | None:
    """Compare engine and clutch hub."""
    engine, hub = columns.get(Signal.ENGINE_SPEED), columns.get(Signal.HUB_SPEED)
    if engine is None or hub is None or not len(engine.t_ns) or not len(hub.t_ns):
        return None
    if engine.sequence[0] < 0 and np.array_equal(engine.t_ns, hub.t_ns):
        return None  # columns of a table, asked one after the other: how far they are apart in time nobody knows
    return limits.hub_mean_rad_s.score(abs(float(_apart(engine, hub).mean())))


def _pressures(columns: Columns, limits: QualityLimits) -> float | None:
    """Compare clutch pressures with what was commanded a moment before."""
    differences_pa = [
        float(np.median(np.abs(_apart(pressure, command, _LAG_NS))))
        for read, commanded in _PRESSURES
        for pressure, command in ((columns.get(read), columns.get(commanded)),)
        if pressure is not None and command is not None and len(pressure.t_ns) and len(command.t_ns)
    ]
    return limits.pressure_median_pa.score(max(differences_pa)) if differences_pa else None


def _apart(series: Series, other: Series, lag_ns: int = 0) -> FloatArray:
    """Return a signal less what another one read at its times, or ``lag_ns`` before them."""
    return np.asarray(series.value - _reading(other, series.t_ns - lag_ns))


def _reading(series: Series, at_ns: Int64Array) -> FloatArray:
    """Return what a signal reads at some times: linear between samples, constant beyond both ends."""
    origin_ns = series.t_ns[0]  # so that floating-point numbers hold nanoseconds
    return np.asarray(np.interp(at_ns - origin_ns, series.t_ns - origin_ns, series.value))


@dataclass(frozen=True, slots=True, kw_only=True)
class Samples:
    """What was sampled in an event that can be used, whatever vehicle it is of."""

    event: Event
    times: SampleTimes
    oil_k: float
    row_s: float = 0.0  # from row to row [s] where signals are columns of a table, else 0
    skew_s: float = 0.0  # by which columns of a row, or values that are asked for, may be apart [s]


def usable_signals(event: Event, calibration: Calibration, limits: QualityLimits = LIMITS) -> AlignedSignals | Reason:
    """Return the signals of a shift or engine run-up on one clock, or why they cannot be used."""
    samples = usable_samples(event, limits)
    return samples if isinstance(samples, Reason) else aligned(samples, calibration, limits=limits)


def usable_samples(event: Event, limits: QualityLimits = LIMITS) -> Samples | Reason:
    """Return the samples of a shift or engine run-up, or why they cannot be used."""
    if event.has_whole_seconds or event.end_reason not in {EndReason.COMPLETE, EndReason.ABANDONED}:
        return Reason.WHOLE_SECONDS if event.has_whole_seconds else Reason.INTERRUPTED
    is_whole = event.end_reason is EndReason.COMPLETE  # what another event cut short may be seen in full, or not
    oil = event.columns.get(Signal.SUMP_TEMPERATURE)
    row_s = _row_s(event, limits)
    if row_s:
        event = _without_near_rows(event, round(limits.near_row_periods * row_s / NS_TO_S))
    sampled = sampling_times(event)
    if oil is None or not len(oil.t_ns) or len(sampled) < len(BALANCE_SIGNALS):
        return Reason.SIGNAL_MISSING if is_whole else Reason.INTERRUPTED
    duration_s = (event.end_ns - event.start_ns) * NS_TO_S
    for one, times_s in sampled.items():
        series = event.columns[one]
        if np.abs(series.value).max(initial=0.0) > MOST:
            return Reason.OUT_OF_RANGE
        own_s = series.period_ns * NS_TO_S or limits.nominal_period_s
        period_s = row_s if row_s and is_of_rows(series) else own_s
        silence_s = longest_silence_s(times_s, -2.0 * period_s, duration_s)
        if silence_s > limits.lost_periods * period_s:
            return _why_silent(event, sampled, limits) if is_whole else Reason.INTERRUPTED
    oil_k = float(oil.value.mean())
    if not limits.oil_range_k[0] <= oil_k <= limits.oil_range_k[1]:
        return Reason.OUT_OF_RANGE
    of_torque, of_pressure = (event.columns[one].t_ns for one in (Signal.ENGINE_TORQUE, Signal.CLUTCH1_PRESSURE))
    skew_s = row_s if np.array_equal(of_torque, of_pressure) else min(row_s, ANSWER_S)  # asked values have own times
    return Samples(event=event, times=sampled, oil_k=oil_k, row_s=row_s, skew_s=skew_s)


def _why_silent(event: Event, sampled: Iterable[Signal], limits: QualityLimits) -> Reason:
    """Return whether frames were late in a silence: then all signals stood still, and no counter proves a loss."""
    for series in (event.columns[one] for one in sampled):
        proven = (np.diff(series.sequence) - 1) % COUNTER_PERIOD + 1
        is_numbered = len(proven) > 0 and series.period_ns > 0 and series.sequence[0] >= 0
        stood_ns = np.diff(series.t_ns).max(initial=0)
        if not is_numbered or proven.max() > limits.lost_periods or stood_ns <= limits.lost_periods * series.period_ns:
            return Reason.FRAMES_MISSING
    return Reason.TIME_UNSURE


def _row_s(event: Event, limits: QualityLimits) -> float:
    """Return the time from row to row [s] of the table that an event is of; 0 if it is of a bus.

    What controllers tell whoever asks makes rows of its own: as slow as the slowest of them.
    """
    columns = [event.columns[one] for one in ROW_SIGNALS if one in event.columns]
    own = [event.columns[one] for one in BALANCE_SIGNALS if one in event.columns]
    if len(columns) < len(ROW_SIGNALS) or all(one.period_ns for one in own):
        return 0.0
    if not (row_ns := row_period_ns(columns)):
        row_ns = max((int(np.median(np.diff(one.t_ns))) for one in own if is_of_rows(one)), default=0)
        if row_ns * NS_TO_S < UNSCHEDULED_PERIODS * limits.nominal_period_s:
            return 0.0  # messages of a bus whose database knows no cycle
    return max(row_ns * NS_TO_S, limits.nominal_period_s)


def _without_near_rows(event: Event, least_ns: int) -> Event:
    """Return an event of a table without rows that come too soon after the one before."""
    columns = dict(event.columns)
    for signal in BALANCE_SIGNALS:
        if (series := columns.get(signal)) is None or not is_of_rows(series):
            continue
        kept, last_ns = list[int](), None
        for place, t_ns in enumerate(series.t_ns.tolist()):
            if last_ns is None or t_ns - last_ns >= least_ns:
                kept.append(place)
                last_ns = t_ns
        columns[signal] = replace(
            series, t_ns=series.t_ns[kept], sequence=series.sequence[kept], value=series.value[kept]
        )
    return replace(event, columns=columns)


def aligned(
    samples: Samples, calibration: Calibration, other: AlignedSignals | None = None, *, limits: QualityLimits = LIMITS
) -> AlignedSignals | Reason:
    """Return samples on one clock, latencies as a calibration has them, or why they cannot be.

    What no calibration moves is taken over from ``other``: the same samples as another calibration has them.
    """
    times = measured_times(samples.times, samples.event, calibration)
    gaps, rows = gaps_s(times, samples.event, limits, samples.row_s), NO_ROWS
    if gaps is None:
        return Reason.TIME_UNSURE  # frames of one message came at one time
    if samples.row_s:
        noise_std = noise_of_signals(calibration.noise)
        if any(np.abs(samples.event.columns[one].value).max() > MOST_NOISES * noise_std[one] for one in times):
            return Reason.OUT_OF_RANGE  # a cell may hold any number
        rows = Rows(
            period_s=samples.row_s,
            skew_s=samples.skew_s,
            own_age_std_s=FRAME_AGE_STD_S if samples.skew_s >= samples.row_s else samples.skew_s / math.sqrt(12.0),
            noise_std=noise_std,
        )
    return align(times, samples.event, samples.oil_k, gaps, other, rows)


def longest_silence_s(times_s: FloatArray, from_s: float, duration_s: float) -> float:
    """Return for how long [s] nothing was sampled between the event's start and its end; inf for fewer than 2 samples.

    Samples before the start count from ``from_s`` on.
    """
    seen_s = times_s[(from_s <= times_s) & (times_s <= duration_s)]
    if len(seen_s) < 2:
        return math.inf
    return max(0.0, float(seen_s[0]), float(np.diff(seen_s).max()), duration_s - float(seen_s[-1]))


def gaps_s(times: SampleTimes, event: Event, limits: QualityLimits = LIMITS, row_s: float = 0.0) -> FloatArray | None:
    """Return between which instants [s] two samples of any signal or more are missing in a row, shape (n, 2).

    None if the times of a signal do not rise.
    """
    duration_s = (event.end_ns - event.start_ns) * NS_TO_S
    found = []
    for signal, times_s in times.items():
        period_s = event.columns[signal].period_ns * NS_TO_S or limits.nominal_period_s
        is_row = row_s and is_of_rows(event.columns[signal])
        longest_s = limits.row_gap_periods * row_s if is_row else limits.gap_periods * period_s
        steps_s = np.diff(times_s)
        if steps_s.min(initial=math.inf) <= 0.0:
            return None
        found += [times_s[row : row + 2] for row in np.flatnonzero(steps_s > longest_s)]
        if duration_s - times_s[-1] > longest_s:
            found.append(np.array((times_s[-1], duration_s)))
    return np.array(found).reshape(-1, 2)


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

_BY_LATENESS: Final = frozenset(
    {
        *(Reason.MISFIT, Reason.SPEEDS_DISAGREE, Reason.PRESSURE_OFF_COMMAND),
        *(Reason.ZERO_JUMPED, Reason.SENSOR_FROZEN, Reason.IMPLAUSIBLE),
    }
)


@dataclass(frozen=True, slots=True, kw_only=True)
class QualityBasis:
    """What a bus and its calibration promise, against which a shift is held."""

    mandatory_messages: frozenset[str] = frozenset()
    scale_ends: Mapping[Signal, tuple[float, float]] = field(default_factory=dict)  # least and largest value, SI
    calibration_date: date | None = None
    torque: TorqueSource = TorqueSource.MEASURED


@np.errstate(over="ignore", invalid="ignore")  # a damaged value of a log may be any number
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


def named_late(event: Event, reasons: tuple[Reason, ...]) -> tuple[Reason, ...]:
    """Return reasons, or lateness in place of those that it explains as well: no sensor is accused for it."""
    return (Reason.TIME_UNSURE,) if event.came_late and not _BY_LATENESS.isdisjoint(reasons) else reasons


@dataclass(frozen=True, slots=True, kw_only=True)
class Gate:
    """What the data of an event are worth, found before anything is estimated from them."""

    quality: DataQuality
    samples: Samples | Reason | None  # what tells friction, or why nothing does; None: the vehicle has no such signals
    against: tuple[Reason, ...]  # why the data must not be believed; empty if they may, or there are none to believe


def gate(event: Event, basis: QualityBasis, limits: QualityLimits = LIMITS, *, tells_friction: bool = True) -> Gate:
    """Judge the data of an event, by themselves: which samples tell its friction, and whether they can be believed."""
    quality = data_quality(event, basis, limits)
    samples = usable_samples(event, limits) if tells_friction else None
    if basis.torque is TorqueSource.WITHOUT_CUT and event.kind not in SLIPS_IN_GEAR and isinstance(samples, Samples):
        samples = Reason.TORQUE_UNKNOWN
    against = () if isinstance(samples, Reason) else reasons_against(quality, limits)
    if event.came_late:
        against = named_late(event, against)
    if event.has_whole_seconds:
        against = (Reason.WHOLE_SECONDS,)
    return Gate(quality=quality, samples=samples, against=against)


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
    late = 0
    for one in series:  # than the schedule of the sample that came earliest by it
        delays_ns = one.t_ns - one.sequence * one.period_ns
        late += int(np.count_nonzero(delays_ns - delays_ns.min() > limits.late_periods * one.period_ns))
    return 1.0 - late / sum(len(one.t_ns) for one in series)


def _saturation(
    columns: Columns, scale_ends: Mapping[Signal, tuple[float, float]], limits: QualityLimits
) -> float | None:
    """Judge how many samples lie at an end of their scale; zero is no end: that is where sensors rest."""
    shares = []
    for signal in BALANCE_SIGNALS:
        if signal in scale_ends and signal in columns and len(value := columns[signal].value):
            low, high = scale_ends[signal]
            margin = 1e-6 * (high - low)
            is_at_end = (value >= high - margin) | ((low < 0.0) & (value <= low + margin))
            shares.append(float(is_at_end.mean()))
    return limits.saturated_ratio.score(max(shares)) if shares else None


def _calibration(end_ns: int, made: date | None, limits: QualityLimits) -> float | None:
    """Judge the age of a calibration that was made for this vehicle on a known day."""
    if made is None:
        return None
    day = datetime.fromtimestamp(end_ns // _NS_PER_S, tz=UTC).date()
    return limits.calibration_years.score((day - made).days / _DAYS_PER_YEAR)
