"""How far the data of one shift can be believed, whatever friction they lead to: a score of 0 to 1, with its parts.

Every part is 1 where nothing speaks against the data and falls to 0 with the evidence; the score is their product. A
part that cannot be judged, because the bus lacks its signals, is left out. Below the least score a shift is rejected.

The second half holds aligned signals against each other. A sensor that lies changes the torque balance, and chi-square
sees that, unless another friction would explain it as well: a pressure that reads too low, a slip that reads too high.
No check here needs friction.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array, Series
from canlog.e2e.e2e_state import E2eState
from clutch_model.calibration import Calibration, TorqueSource, clutch_of_gear
from clutch_results.event_kinds import SLIPS_IN_GEAR, EndReason, EventKind
from clutch_results.records import DataQuality, QualityPart, Reason, ShiftEstimate, Status
from diag_service.diagnosis.alignment import (
    COMMAND_LAG_S,
    GRID_S,
    NS_TO_S,
    AlignedSignals,
    EventSamples,
    usable_samples,
)
from diag_service.diagnosis.columns import BALANCE_SIGNALS, NO_SAMPLES, Columns, Signal
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

    # Data quality: each part from 0 to 1, and the least product of all parts.
    least_score_ratio: float = 0.5
    lost_ratio: Band = Band(start=0.0, end=0.4)  # of frames: half of it rejects an event; gaps are left out besides
    optional_message_ratio: float = 0.9  # factor for each message that failed, though no estimate needs it
    late_periods: float = 3.0  # a sample this much later than its sender's schedule says little about time
    saturated_ratio: Band = Band(start=0.0, end=0.1)  # of samples at the end of the scale
    wheel_ratio: Band = Band(start=0.03, end=0.13)  # rms of driven wheel over output speed; sound: 0.022
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
    least_noise_steps: float = 0.75  # of the resolution; a ramp without noise seems to have up to 0.6
    repeats_chance: float = 1e-6  # that a sound signal repeats a value as often as one that is called frozen


LIMITS: Final = QualityLimits()
SHAFT_GEARS: Final = (Signal.INPUT1_GEAR, Signal.INPUT2_GEAR)
_LAG_NS: Final = round(COMMAND_LAG_S / NS_TO_S)
_NEVER: Final = np.empty(0, np.int64)
DRIVEN_WHEELS: Final = 2  # of an axle
_WHEELS: Final = (Signal.WHEEL_FL_SPEED, Signal.WHEEL_FR_SPEED, Signal.WHEEL_RL_SPEED, Signal.WHEEL_RR_SPEED)
_PRESSURES: Final = (
    (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH1_PRESSURE_COMMAND),
    (Signal.CLUTCH2_PRESSURE, Signal.CLUTCH2_PRESSURE_COMMAND),
)


def agreement(event: Event) -> float | None:
    """Return how well sensors agree that must, 0 to 1; the worst pair counts, None if there is no pair."""
    columns = event.columns
    # With both clutches open nothing is asked of them, and a piston that returns holds the pressure of its spring.
    pressures = None if event.kind is EventKind.REGEAR else _pressures(columns)
    judged = (_wheels(columns), _hub(columns), pressures)
    return min([value for value in judged if value is not None], default=None)


def _wheels(columns: Columns) -> float | None:
    """Compare wheel speeds with the speed of the transmission output: the ratio of each is one number.

    Both wheels of a driven axle turn with the output. The others need not: in a launch of 180 N m driven tyres slip by
    a tenth. So two wheels that agree are enough, whichever they are. While a shaft rings in its new gear, so does the
    output: that tells nothing of the sensors.
    """
    output = columns.get(Signal.OUTPUT_SPEED, NO_SAMPLES)
    if not len(output.t_ns):
        return None
    gears = [columns[signal] for signal in SHAFT_GEARS if signal in columns]
    changes_ns = np.concatenate([_NEVER, *[gear.t_ns[1:][np.diff(gear.value) != 0.0] for gear in gears]])
    scatters = []
    for wheel in [columns[signal] for signal in _WHEELS if signal in columns]:
        turning_rad_s = _reading(output, wheel.t_ns)
        is_turning = (wheel.value > LIMITS.least_wheel_m_s) & (turning_rad_s > 0.0)
        for change_ns in changes_ns:
            is_turning &= np.abs(wheel.t_ns - change_ns) * NS_TO_S > LIMITS.ringing_s
        ratio = wheel.value[is_turning] / turning_rad_s[is_turning]
        if len(ratio):
            scatters.append(math.sqrt(np.mean((ratio / np.median(ratio) - 1.0) ** 2)))
    return LIMITS.wheel_ratio.score(sorted(scatters)[:DRIVEN_WHEELS][-1]) if scatters else None


def _hub(columns: Columns) -> float | None:
    """Compare engine and clutch hub."""
    engine, hub = columns.get(Signal.ENGINE_SPEED, NO_SAMPLES), columns.get(Signal.HUB_SPEED, NO_SAMPLES)
    if not len(engine.t_ns) or not len(hub.t_ns):
        return None
    if engine.sequence[0] < 0 and np.array_equal(engine.t_ns, hub.t_ns):
        return None  # columns of a table, asked one after the other: how far they are apart in time nobody knows
    return LIMITS.hub_mean_rad_s.score(abs(float((engine.value - _reading(hub, engine.t_ns)).mean())))


def _pressures(columns: Columns) -> float | None:
    """Compare clutch pressures with what was commanded a moment before."""
    differences_pa = []
    for reading, commanded in _PRESSURES:
        pressure, command = columns.get(reading, NO_SAMPLES), columns.get(commanded, NO_SAMPLES)
        if len(pressure.t_ns) and len(command.t_ns):
            difference_pa = pressure.value - _reading(command, pressure.t_ns - _LAG_NS)
            differences_pa.append(float(np.median(np.abs(difference_pa))))
    return LIMITS.pressure_median_pa.score(max(differences_pa)) if differences_pa else None


def _reading(series: Series, at_ns: Int64Array) -> FloatArray:
    """Return what a signal reads at some times: linear between samples, constant beyond both ends."""
    origin_ns = series.t_ns[0]  # so that floating-point numbers hold nanoseconds
    return np.asarray(np.interp(at_ns - origin_ns, series.t_ns - origin_ns, series.value))


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
def data_quality(event: Event, basis: QualityBasis) -> DataQuality:
    """Return how far the data of a shift can be believed."""
    numbered = _numbered(event.columns)
    judged = {
        QualityPart.FRAMES: _frames(numbered),
        QualityPart.PROTECTION: _protection(event, basis.mandatory_messages),
        QualityPart.TIME: _time(numbered),
        QualityPart.SATURATION: _saturation(event.columns, basis.scale_ends),
        QualityPart.PLAUSIBILITY: agreement(event),
        QualityPart.CALIBRATION: _calibration(event.end_ns, basis.calibration_date),
    }
    parts = {part: value for part, value in judged.items() if value is not None}
    return DataQuality(score=math.prod(parts.values()), parts=parts)


def reasons_against(quality: DataQuality) -> tuple[Reason, ...]:
    """Return why a shift must not be used; nothing if it may."""
    if quality.score >= LIMITS.least_score_ratio:
        return ()
    named = tuple(_REASONS[part] for part, value in quality.parts.items() if value < LIMITS.least_score_ratio)
    return named or (Reason.LOW_DATA_QUALITY,)


def named_late(event: Event, reasons: tuple[Reason, ...]) -> tuple[Reason, ...]:
    """Return reasons, or lateness in place of those that it explains as well: no sensor is accused for it."""
    return (Reason.TIME_UNSURE,) if event.came_late and not _BY_LATENESS.isdisjoint(reasons) else reasons


@dataclass(frozen=True, slots=True, kw_only=True)
class Gate:
    """What the data of an event are worth, found before anything is estimated from them."""

    quality: DataQuality
    samples: EventSamples | Reason | None  # what tells friction, or why nothing does; None: no such signals
    against: tuple[Reason, ...]  # why the data must not be believed; empty if they may, or there are none to believe


def gate(event: Event, basis: QualityBasis, *, tells_friction: bool = True) -> Gate:
    """Judge the data of an event, by themselves: which samples tell its friction, and whether they can be believed."""
    quality = data_quality(event, basis)
    samples = usable_samples(event) if tells_friction else None
    if (
        basis.torque is TorqueSource.WITHOUT_CUT
        and event.kind not in SLIPS_IN_GEAR
        and isinstance(samples, EventSamples)
    ):
        samples = Reason.TORQUE_UNKNOWN
    against = () if isinstance(samples, Reason) else reasons_against(quality)
    if event.came_late:
        against = named_late(event, against)
    if event.has_whole_seconds:
        against = (Reason.WHOLE_SECONDS,)
    return Gate(quality=quality, samples=samples, against=against)


def _numbered(columns: Columns) -> list[Series]:
    """Return the signals of the torque balance whose message counts its transmissions."""
    series = [columns[signal] for signal in BALANCE_SIGNALS if signal in columns]
    return [column for column in series if len(column.t_ns) and column.sequence[0] >= 0]


def _frames(numbered: Sequence[Series]) -> float | None:
    """Judge the share of frames that never came or could not be used."""
    sent = sum([int(column.sequence[-1] - column.sequence[0]) + 1 for column in numbered])
    if not sent:
        return None
    return LIMITS.lost_ratio.score(1.0 - sum([len(column.t_ns) for column in numbered]) / sent)


def _protection(event: Event, mandatory: frozenset[str]) -> float | None:
    """Judge the messages by their E2E state: one that the estimate needs and that is not valid is fatal."""
    if not mandatory and not event.e2e:
        return None
    failed = [message for message, state in event.e2e.items() if state is not E2eState.VALID]
    if not event.e2e.keys() >= mandatory or mandatory.intersection(failed):
        return 0.0
    return float(LIMITS.optional_message_ratio ** sum(event.e2e[message] is E2eState.INVALID for message in failed))


def _time(numbered: Sequence[Series]) -> float | None:
    """Judge how many samples came much later than the schedule that their numbers show."""
    series = [column for column in numbered if column.period_ns > 0]
    if not series:
        return None
    late = 0
    for column in series:  # than the schedule of the sample that came earliest by it
        delays_ns = column.t_ns - column.sequence * column.period_ns
        late += int(np.count_nonzero(delays_ns - delays_ns.min() > LIMITS.late_periods * column.period_ns))
    return 1.0 - late / sum([len(column.t_ns) for column in series])


def _saturation(columns: Columns, scale_ends: Mapping[Signal, tuple[float, float]]) -> float | None:
    """Judge how many samples lie at an end of their scale; zero is no end: that is where sensors rest."""
    shares = []
    for signal in BALANCE_SIGNALS:
        if signal in scale_ends and signal in columns and len(value := columns[signal].value):
            low, high = scale_ends[signal]
            margin = 1e-6 * (high - low)
            is_at_end = (value >= high - margin) | ((low < 0.0) & (value <= low + margin))
            shares.append(float(is_at_end.mean()))
    return LIMITS.saturated_ratio.score(max(shares)) if shares else None


def _calibration(end_ns: int, made: date | None) -> float | None:
    """Judge the age of a calibration that was made for this vehicle on a known day."""
    if made is None:
        return None
    day = datetime.fromtimestamp(end_ns // _NS_PER_S, tz=UTC).date()
    return LIMITS.calibration_years.score((day - made).days / _DAYS_PER_YEAR)


_LEAST: Final = 0.0  # what a sensor of pressure or speed cannot show less of: it repeats that with reason
_STD_OF_SECOND_DIFFERENCE: Final = 1.4826 / math.sqrt(6.0)  # of white noise, over the median of their sizes
_WITHOUT_LOCK: Final = frozenset({EventKind.CREEP, EventKind.REGEAR})  # a car may stop first; both clutches are open
LEAST_RATIO, MOST_RATIO = 0.7, 1.25  # of the friction that the type has new: no fluid leaves these
SURE_STD: Final = 1.0  # that a friction is granted before it is called impossible
MOST_MISFITS: Final = 3  # without one event that fits
_MISFITS: Final = frozenset({Reason.MISFIT, Reason.SPEEDS_DISAGREE, Reason.IMPLAUSIBLE})


@dataclass(frozen=True, slots=True, kw_only=True)
class SlippingClutch:
    """The on-coming clutch of a shift, as far as its signals can be held against each other."""

    number: int  # 1 or 2
    rows: slice  # of the grid, in which it alone is loaded and slips
    pressure_zero_pa: float  # what its pressure sensor reads without pressure
    touch_pressure_pa: float  # below it the return springs hold the pressure, whatever is commanded


def plausibility_faults(event: Event, signals: AlignedSignals, clutch: SlippingClutch) -> tuple[Reason, ...]:
    """Return why the signals of a shift, once put on one clock, cannot all be true; empty if they can."""
    apart_rad_s = signals.speeds_apart_rad_s
    is_change = event.from_gear != event.to_gear
    start = signals.grid_s.searchsorted(0.0)  # before a launch the engine may be started
    at_hub_rad_s = signals.engine_speed.on_grid[start:] - signals.hub_speed.on_grid[start:]  # tied by a torsion damper
    most_at_hub_rad_s = LIMITS.speeds_rad_s if is_change else LIMITS.launch_speeds_rad_s
    faults = {
        Reason.SENSOR_FROZEN: any(is_frozen(event.columns[signal], signal) for signal in BALANCE_SIGNALS),
        Reason.SPEEDS_DISAGREE: speed_gap_rad_s(event, signals, clutch) > LIMITS.speeds_rad_s + apart_rad_s
        or _largest_mean(at_hub_rad_s, LIMITS.speeds_mean_s) > most_at_hub_rad_s + apart_rad_s,
        Reason.PRESSURE_OFF_COMMAND: _misses_command(signals, clutch),
    }
    return tuple(reason for reason, is_there in faults.items() if is_there)


def is_frozen(series: Series, signal: Signal) -> bool:
    """Return whether a signal repeats one value longer than its own noise and resolution explain.

    How often neighbours are equal elsewhere in the signal says how likely a repetition is. Of a signal without noise it
    says nothing: it may well rest.
    """
    value = series.value
    edges = np.flatnonzero(np.diff(value, prepend=np.nan, append=np.nan) != 0.0)  # of runs of one value
    lengths = np.diff(edges)
    run_count, first, longest = len(lengths), int(edges[lengths.argmax()]), int(lengths.max())
    if signal is not Signal.ENGINE_TORQUE and value[first] <= _LEAST:
        return False
    others = len(value) - longest
    repeats = others - (run_count - 1)
    share = (repeats + 1.0) / (others + 2.0)
    if longest <= 1.0 + math.log(LIMITS.repeats_chance / len(value)) / math.log(share):
        return False
    return _noise_in_steps(value, first, first + longest) >= LIMITS.least_noise_steps


def _noise_in_steps(value: FloatArray, first: int, stop: int) -> float:
    """Return the noise of all but some rows in steps of its resolution, by its second differences; inf if too few."""
    steps = np.diff(np.concatenate((value[:first], value[stop:])))
    moved = np.abs(steps[steps != 0.0])
    if len(steps) < 3 or not len(moved):
        return math.inf
    return float(np.median(np.abs(np.diff(steps)))) * _STD_OF_SECOND_DIFFERENCE / float(moved.min())


def speed_gap_rad_s(event: Event, signals: AlignedSignals, clutch: SlippingClutch) -> float:
    """Return the largest mean difference [rad/s] between speeds that must agree.

    Hub and input shaft of the clutch that is locked before a change of gears, and of the one that is locked at the end;
    both input shafts up to their ratio, as long as each keeps its gear.
    """
    end_s = (event.end_ns - event.start_ns) * NS_TO_S
    grid_s = signals.grid_s
    gaps = [shaft_gap_rad_s(signals, rows) for rows in geared_stretches(event, grid_s, clutch)]
    if event.from_gear != event.to_gear and event.kind is not EventKind.REGEAR:
        locked = signals.slip_rad_s[clutch_of_gear(event.from_gear) - 1]
        gaps.append(abs(float(locked[: grid_s.searchsorted(grid_s[0] + LIMITS.locked_s)].mean())))
    if event.kind not in _WITHOUT_LOCK and event.end_reason is EndReason.COMPLETE:
        closed = signals.slip_rad_s[clutch_of_gear(event.to_gear) - 1][grid_s.searchsorted(end_s - LIMITS.locked_s) :]
        middle = len(closed) // 2  # a coast change still slips; what a sensor reads too much changes less fast
        is_settling = abs(float(closed[middle:].mean() - closed[:middle].mean())) > LIMITS.settling_rad_s
        gaps.append(0.0 if is_settling else abs(float(closed.mean())))
    return max(gaps, default=0.0)


def geared_stretches(event: Event, grid_s: FloatArray, clutch: SlippingClutch) -> list[slice]:
    """Return the stretches of the grid in which each input shaft keeps its gear.

    Where the shafts say their gears, what is near a new one is left out: the shaft rings, and its message may be late.
    Where they do not, they stand in gear from a moment before the slip window on.
    """
    gears = [event.columns.get(signal) for signal in SHAFT_GEARS]
    first, second = gears
    if first is None or second is None:
        return [slice(max(0, clutch.rows.start - round(LIMITS.in_gear_s / GRID_S)), len(grid_s))]
    held = np.stack([_held(series, event.start_ns, grid_s) for series in (first, second)])
    edges = np.flatnonzero((held[:, 1:] != held[:, :-1]).any(axis=0)) + 1
    ringing = round(LIMITS.ringing_s / GRID_S)
    starts = [0, *(edges + ringing).tolist()]
    stretches = zip(starts, [*(edges - ringing).tolist(), len(grid_s)], strict=True)
    least = round(LIMITS.speeds_mean_s / GRID_S)
    return [slice(start, stop) for start, stop in stretches if stop - start >= least and held[:, start].min() > 0.0]


def _held(series: Series, origin_ns: int, grid_s: FloatArray) -> FloatArray:
    """Return the value in force at each point of the grid; the first one before its time."""
    latest = ((series.t_ns - origin_ns) * NS_TO_S).searchsorted(grid_s, "right") - 1
    return series.value[np.maximum(latest, 0)]


def shaft_gap_rad_s(signals: AlignedSignals, rows: slice) -> float:
    """Return how far both input shafts are apart [rad/s], up to the ratio of their gears."""
    first, second = signals.input_speed[0].on_grid[rows], signals.input_speed[1].on_grid[rows]
    does_turn = second > LIMITS.turning_rad_s  # at a standstill there is no ratio
    if not does_turn.any():
        return 0.0
    return _largest_mean(first - np.median(first[does_turn] / second[does_turn]) * second, LIMITS.speeds_mean_s)


def _misses_command(signals: AlignedSignals, clutch: SlippingClutch) -> bool:
    """Return whether the slipping clutch's pressure is not the commanded one; False without a command.

    A piston on its way is held against nothing: its spring sets the pressure, whatever is commanded.
    """
    expected_pa = signals.expected_pa[clutch.number - 1]
    if expected_pa is None:
        return False
    first, touch_pa = clutch.rows.start, clutch.touch_pressure_pa
    read_pa = signals.pressure[clutch.number - 1].on_grid[clutch.rows] - clutch.pressure_zero_pa
    judged_pa = expected_pa[clutch.rows]
    longest = round(LIMITS.catching_up_s / GRID_S)
    has_arrived = _arrived(read_pa, judged_pa, touch_pa + LIMITS.travel_pa, LIMITS.pressure_window_pa, longest)
    if np.count_nonzero(has_arrived) * GRID_S < LIMITS.pressure_mean_s:
        return False
    by_clock_pa = LIMITS.command_clock_s * abs(float(judged_pa[-1] - judged_pa[0])) / (len(judged_pa) * GRID_S)
    error_pa = np.maximum(read_pa, touch_pa) - np.maximum(judged_pa, touch_pa)
    rate_pa_s = np.gradient(expected_pa, GRID_S)[first : first + len(read_pa)]
    excused_pa = LIMITS.following_ratio * COMMAND_LAG_S * np.abs(rate_pa_s)  # so far it may be ahead of the command
    beyond_pa = np.copysign(np.maximum(np.abs(error_pa) - excused_pa, 0.0), error_pa) * has_arrived
    return (
        abs(float(error_pa[has_arrived].mean())) > LIMITS.pressure_window_pa + by_clock_pa
        or _largest_mean(beyond_pa, LIMITS.pressure_mean_s) > LIMITS.pressure_moment_pa
    )


def _arrived(
    read_pa: FloatArray, expected_pa: FloatArray, pressing_pa: float, behind_pa: float, longest: int
) -> BoolArray:
    """Return where a piston presses: not on its way, nor its pressure still rising to the command behind it.

    So long a rise lasts ``longest`` rows at most.
    """
    presses = read_pa > pressing_pa
    has_arrived, is_behind = presses.copy(), expected_pa - read_pa > behind_pa
    for start in (np.flatnonzero(presses[1:] & ~presses[:-1]) + 1).tolist():
        rising = is_behind[start : start + longest]
        has_arrived[start : start + (len(rising) if rising.all() else int(rising.argmin()))] = False
    return has_arrived


def _largest_mean(values: FloatArray, span_s: float) -> float:
    """Return the largest magnitude of the running mean over a span of the grid."""
    count, sums = min(round(span_s / GRID_S), len(values)), np.concatenate([[0.0], np.cumsum(values)])
    return float(np.abs(sums[count:] - sums[: len(sums) - count]).max()) / count


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalMeaning:
    """Whether signals that were asked for can be what the profile says, by the estimates of a drive so far."""

    doubt: str = ""  # what cannot be; empty as long as all of it can
    fit_count: int = 0  # of events
    misfit_count: int = 0

    def believes(self, estimate: ShiftEstimate) -> bool:
        """Return whether the estimate of an event that is counted here may be believed."""
        return not self.doubt or estimate.status is not Status.VALID

    def with_estimate(self, estimate: ShiftEstimate, calibration: Calibration) -> "SignalMeaning":
        """Return the same after one more event; ``calibration`` is that of the type."""
        if self.doubt:
            return self
        if (friction := estimate.friction) is not None:
            new = calibration.clutches[estimate.clutch - 1].friction.mu_c
            ratio, spread = friction.mu_c / new, SURE_STD * friction.std_mu_c / new
            if ratio + spread < LEAST_RATIO or ratio - spread > MOST_RATIO:
                text = (
                    f"friction would be {ratio:.0%} of what this type has new: torque, pressure or their scales are "
                    "not what profile and calibration say"
                )
                return replace(self, doubt=text)
        fits = self.fit_count + (estimate.status is Status.VALID)  # also of a modelled torque
        misfits = self.misfit_count + (not _MISFITS.isdisjoint(estimate.reasons))
        is_off = misfits >= MOST_MISFITS and not fits
        text = f"none of {misfits} events fits: pressures, torque and speeds do not fit together as the profile says"
        return SignalMeaning(doubt=text if is_off else "", fit_count=fits, misfit_count=misfits)
