"""The signals of one event on one clock and one even grid: when samples were taken, and what they read in between."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array, Series
from canlog.e2e.alive_counter import row_period_ns
from canlog.e2e.profile1 import COUNTER_PERIOD
from canlog.jit import kernel
from clutch_model.calibration import InputSide, SensorBias, SensorNoise
from clutch_results.event_kinds import EndReason
from clutch_results.records import Reason
from diag_service.diagnosis.columns import BALANCE_SIGNALS, ROW_SIGNALS, Columns, Signal
from diag_service.diagnosis.events import Event

NS_TO_S = 1e-9
GRID_S = 2e-3  # five points per CAN sample; a finer grid moves friction by a tenth of its deviation
TURNING_RAD_S = 58.0  # 554 rpm: below any idle; there a starter may turn the engine, which no torque reading tells
END_COUNT = 30  # samples, of which one is nearly on time; an event is cut that much wider than its slip window
COMMAND_LAG_S = 0.025  # from commanded to piston pressure: solenoid and feed orifice; docs/model.md, hydraulics
FRAME_AGE_STD_S = 3e-3  # of a value that was sent every 10 ms before it was asked for
ANSWER_S = 0.025  # after a request some controller reads a value, nobody knows when
GAP_PERIODS: Final = 2.5  # one missing frame is bridged by interpolation; in a longer gap no friction is looked for
LOST_PERIODS: Final = 8.5  # a longer gap may hide anything: the event is not used
NOMINAL_PERIOD_S: Final = 0.01  # of signals whose message states no cycle time
ROW_GAP_PERIODS: Final = 3.5  # as gap_periods, of the rows of a table, which come unevenly
NEAR_ROW_PERIODS: Final = 0.25  # a row that comes so soon after another tells nothing beside it
OIL_RANGE_K: Final = (233.15, 443.15)  # -40..170 degC: where the fluid's viscosity law holds

POINT_S, POINTS_PER_ROW = 0.01, 4  # of the curve through rows: as near as frames, or as is of use
WALK_RATIO = 2.0  # of what slopes near by say: of four each may be small by chance
LEAST_WALK = 1.0  # of what the noise of three rows alone would look like
HELD_STEPS, HELD_ROWS, LEAST_RUNS = 2.5, 1.5, 4  # of the resolution, of the rows, of what must agree

_NO_WEIGHT = 1e-9  # of grid points: a sample at the very end of some rows says nothing there
_MOVED = (Signal.ENGINE_SPEED, Signal.ENGINE_TORQUE, Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE)  # by latencies
AGE_RATIO: Mapping[Signal, float] = {
    **dict.fromkeys(BALANCE_SIGNALS, 0.3),  # of a row: columns are asked one after the other
    **dict.fromkeys((Signal.ENGINE_SPEED, Signal.ENGINE_TORQUE), 0.0),  # the latencies of torque and pressure hold that
    **dict.fromkeys((Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE), 0.15),  # what both do not share
}
"""Standard deviation of the age of values within a row, of its length."""


class Sensing(Protocol):
    """What is known of a vehicle's sensors: by its calibration, or displaced from that."""

    @property
    def input_side(self) -> InputSide:
        """Crank segment over which the engine speed is a mean."""

    @property
    def bias(self) -> SensorBias:
        """Latencies of torque and pressures."""

    @property
    def noise(self) -> SensorNoise:
        """White noise of the readings."""


def noise_of_signals(noise: SensorNoise) -> dict[Signal, float]:
    """Return the noise of the sensor of each signal of the balance."""
    return {
        Signal.ENGINE_SPEED: noise.engine_speed_rad_s,
        Signal.ENGINE_TORQUE: noise.engine_torque_nm,
        Signal.HUB_SPEED: noise.hub_speed_rad_s,
        **dict.fromkeys((Signal.INPUT1_SPEED, Signal.INPUT2_SPEED), noise.input_speed_rad_s),
        **dict.fromkeys((Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE), noise.pressure_pa),
    }


class RowCurve:
    """The curve through the rows of a column that bends as little as its rows do, and how sure it is.

    What the column does between rows is a random walk of its slope, as large as the slopes of rows near by differ; what
    is off in each row is independent; an age that all rows share moves the whole curve.

    Parameters
    ----------
    times_s, value : (n,) array
        The column; n >= 2.
    noise_std
        Of its sensor.
    age_std_s, own_age_std_s
        Of the age that all rows share, and of that which each has of its own.
    """

    def __init__(
        self, times_s: FloatArray, value: FloatArray, noise_std: float, age_std_s: float, own_age_std_s: float
    ) -> None:
        from scipy.linalg import cho_solve_banded, cholesky_banded  # noqa: PLC0415 - it takes a while to load

        rise, moved = np.diff(value), np.abs(np.diff(value)) > 0.0
        step = float(np.abs(rise[moved]).min()) if moved.any() else 0.0
        own_s = math.hypot(own_age_std_s, held_s(times_s, value, step) / math.sqrt(12.0))
        variance = noise_std**2 + step**2 / 12.0 + (own_s * np.gradient(value, times_s)) ** 2
        period_s = float(np.median(np.diff(times_s)))
        spacing_s = max(POINT_S, period_s / POINTS_PER_ROW)
        count = max(3, math.ceil((times_s[-1] - times_s[0]) / spacing_s) + 1)
        self.times_s, spacing_s = np.linspace(times_s[0], times_s[-1], count, retstep=True)
        walk = _slope_walk(times_s, value, noise_std)[np.searchsorted(times_s[1:-1], self.times_s[1:-1])]
        stiffness = 1.0 / (walk * spacing_s**3)
        bands = np.zeros((3, count))  # of the information, upper form
        for k, first in enumerate((1.0, -2.0, 1.0)):
            for j, second in enumerate((1.0, -2.0, 1.0)[k:]):
                bands[2 - j, k + j : count - 2 + k + j] += first * second * stiffness
        left = np.minimum(((times_s - times_s[0]) / spacing_s).astype(np.int64), count - 2)
        share = (times_s - self.times_s[left]) / spacing_s
        rows, at = np.zeros((len(value), count)), np.arange(len(value))  # each by the points, in deviations
        rows[at, left], rows[at, left + 1] = 1.0 - share, share
        rows /= np.sqrt(variance)[:, None]
        bands[2] += (rows**2).sum(axis=0)
        bands[1, 1:] += (rows[:, :-1] * rows[:, 1:]).sum(axis=0)
        self._root, self._noise_std = cholesky_banded(bands), noise_std
        self._by_rows = cho_solve_banded((self._root, False), rows.T)
        self.value = self._by_rows @ (value / np.sqrt(variance))
        self._moved_by_age = age_std_s * np.gradient(self.value, spacing_s)

    def covariance(self, first: int, stop: int) -> FloatArray:
        """Return that of the points ``first <= point < stop``, in variances of the sensor."""
        from scipy.linalg import cho_solve_banded  # noqa: PLC0415 - it takes a while to load

        unit = np.eye(len(self.value), stop - first, -first)
        by_age = self._moved_by_age[first:stop]
        covariance = cho_solve_banded((self._root, False), unit)[first:stop] + np.outer(by_age, by_age)
        return np.asarray(covariance / self._noise_std**2)

    def followed(self, first: int, stop: int) -> FloatArray:
        """Return likewise how far points are off where they are high: by what noise of rows the loose walk lets in."""
        by_rows = self._by_rows[first:stop] / self._noise_std
        return np.asarray((1.0 - 1.0 / WALK_RATIO) * by_rows @ by_rows.T)


def _slope_walk(times_s: FloatArray, value: FloatArray, noise_std: float) -> FloatArray:
    """Return by how much the variance of a column's slope grows in a second between its rows, shape (n - 1,)."""
    periods_s = np.diff(times_s)
    if len(value) < 3:
        return np.full(1, (np.ptp(value) + noise_std) ** 2 / periods_s[0] ** 3)
    spans_s = periods_s[1:] + periods_s[:-1]
    walk = 3.0 * np.diff(np.diff(value) / periods_s) ** 2 / spans_s
    walk = np.pad(walk, 2, mode="edge")
    near = (walk[:-3] + walk[1:-2] + walk[2:-1] + walk[3:]) * (WALK_RATIO / 4.0)
    return np.asarray(np.maximum(near, LEAST_WALK * noise_std**2 / np.median(periods_s) ** 3))


def held_s(times_s: FloatArray, value: FloatArray, step: float) -> float:
    """Return for how long [s] a column holds a value while it moves; 0 if each row has its own.

    Where runs of one value end in a jump of several steps they were held, not at rest.
    """
    starts = np.flatnonzero(np.diff(value, prepend=np.nan) != 0.0)
    if len(starts) < LEAST_RUNS:
        return 0.0
    jumps = np.abs(np.diff(value[starts])) > HELD_STEPS * step
    lengths_s = np.diff(times_s[starts])[jumps]
    if len(lengths_s) < LEAST_RUNS:
        return 0.0
    held = float(np.median(lengths_s))
    return held if held > HELD_ROWS * float(np.median(np.diff(times_s))) else 0.0


Sums = Sequence[FloatArray]
SampleTimes = Mapping[Signal, FloatArray]
"""When each signal of the balance was sampled [s] after the start of its event."""


@dataclass(slots=True, init=False, eq=False)
class Resampled:
    """One signal of an event: when it was sampled, what it read, and the same on the even grid.

    Grid point j reads ``(1 - share[j]) * value[left[j]] + share[j] * value[left[j] + 1]``: linear between samples,
    constant beyond both ends. There are two or more ``times_s``, strictly increasing.
    """

    times_s: FloatArray  # (n,) after the start of the event
    value: FloatArray  # (n,)
    left: Int64Array  # (len(grid),)
    share: FloatArray  # (len(grid),)
    on_grid: FloatArray  # (len(grid),)
    curve: RowCurve | None  # through few rows, whose points stand for samples; None: each sample for itself

    def __init__(
        self, times_s: FloatArray, value: FloatArray, grid_s: FloatArray, curve: RowCurve | None = None
    ) -> None:
        self.times_s, self.value, self.curve = times_s, value, curve
        if curve is not None:
            times_s, value = curve.times_s, curve.value
        self.left = np.clip(times_s.searchsorted(grid_s, "right") - 1, 0, len(times_s) - 2)
        begin_s = times_s[self.left]
        self.share = np.clip((grid_s - begin_s) / (times_s[self.left + 1] - begin_s), 0.0, 1.0)
        self.on_grid = (1.0 - self.share) * value[self.left] + self.share * value[self.left + 1]

    def to_samples(self, weights: Sequence[FloatArray], pieces: Sequence[slice]) -> tuple[FloatArray, ...]:
        """Return the weight of each sample in weighted sums over pieces of the grid, shape (k, n) each.

        ``weights`` has shape (k, rows) for each piece; the samples are those that its rows lie between.
        """
        by_piece = []
        for of_rows, rows in zip(weights, pieces, strict=True):
            place, share = self.left[rows] - self.left[rows][0], self.share[rows]
            shares, row = np.zeros((len(place), place[-1] + 2)), np.arange(len(place))
            shares[row, place], shares[row, place + 1] = 1.0 - share, share
            by_piece.append(of_rows @ shares)
        return tuple(by_piece)

    def shared(
        self, first_sum: Sums, second_sum: Sums, rows: Sequence[slice], *, is_followed: bool = False
    ) -> list[FloatArray]:
        """Return covariances of two sums with weights of `to_samples`, in variances of the sensor."""
        if self.curve is None:
            return [first @ second.T for first, second in zip(first_sum, second_sum, strict=True)]
        of_points = self.curve.followed if is_followed else self.curve.covariance
        return [
            first @ of_points(self.left[piece][0], self.left[piece][-1] + 2) @ second.T
            for first, second, piece in zip(first_sum, second_sum, rows, strict=True)
        ]

    def around_samples(
        self, values: FloatArray, places: Sequence[slice], pieces: Sequence[slice]
    ) -> tuple[FloatArray, ...]:
        """Return values as means around the samples of `to_samples`, shape (n,) each; ``places`` are of the pieces."""
        means = []
        for place, rows in zip(places, pieces, strict=True):
            left, share, of_rows = self.left[rows] - self.left[rows][0], self.share[rows], values[place]
            both, count = np.concatenate([left, left + 1]), left[-1] + 2
            weight = np.bincount(both, np.concatenate([1.0 - share, share]), count)
            total = np.bincount(both, np.concatenate([(1.0 - share) * of_rows, share * of_rows]), count)
            means.append(total / np.maximum(weight, _NO_WEIGHT))
        return tuple(means)


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignedSignals:
    """Everything measured in one shift, on one clock that starts with the shift."""

    grid_s: FloatArray
    engine_speed: Resampled
    engine_torque: Resampled
    hub_speed: Resampled
    input_speed: tuple[Resampled, Resampled]
    slip_rad_s: tuple[FloatArray, FloatArray]  # of clutch 1 and 2 on the grid: hub minus input shaft
    pressure: tuple[Resampled, Resampled]
    expected_pa: tuple[FloatArray | None, FloatArray | None]  # on the grid, from the command: free of sensor noise
    oil_k: float
    is_seen: BoolArray  # (len(grid),) whether every signal was sampled near by
    row_s: float = 0.0  # from row to row [s] where signals are columns of a table, else 0

    @property
    def speeds_apart_rad_s(self) -> float:
        """By how much speeds of one instant may be apart: those of one row by what they change until the next one."""
        if not self.row_s:
            return 0.0
        speeds = (self.engine_speed, self.hub_speed, *self.input_speed)
        return max(float(np.abs(np.diff(speed.value)).max()) for speed in speeds)


@dataclass(frozen=True, slots=True, kw_only=True)
class EventSamples:
    """What was sampled in an event that can be used, whatever vehicle it is of."""

    event: Event
    times: SampleTimes
    oil_k: float
    row_s: float = 0.0  # from row to row [s] where signals are columns of a table, else 0
    skew_s: float = 0.0  # by which columns of a row, or values that are asked for, may be apart [s]


def sample_times_s(series: Series, origin_ns: int) -> FloatArray:
    """Return when the samples were taken [s] after ``origin_ns``, shape (n,), freed of transmission jitter.

    A sender with a schedule sends transmission k at ``t_0 + k * period``, and a bus only ever delays. So ``t_0`` is the
    earliest that any sample of the shift allows, however late the others came. The receive times stand where the
    message has no counter, or the sender did not keep to one schedule: then no sample near one end of the shift comes
    within a period of it.
    """
    times_s = np.asarray((series.t_ns - origin_ns) * NS_TO_S, dtype=np.float64)
    if series.period_ns <= 0 or len(times_s) == 0 or series.sequence[0] < 0:
        return times_s
    scheduled_s = (series.sequence - series.sequence[0]) * (series.period_ns * NS_TO_S)
    delay_s = times_s - scheduled_s
    earliest_s = delay_s.min()
    if max(delay_s[:END_COUNT].min(), delay_s[-END_COUNT:].min()) - earliest_s > series.period_ns * NS_TO_S:
        return times_s
    return np.asarray(scheduled_s + earliest_s)


def segment_centres_s(times_s: FloatArray, speed_rad_s: FloatArray, segment_rad: float) -> FloatArray:
    """Return the instants to which mean speeds over the last crank segment belong: half a segment earlier.

    An engine that stands or is being started has no segments: its speed is taken as one of `TURNING_RAD_S`.
    """
    centres_s: FloatArray = times_s - 0.5 * segment_rad / np.maximum(speed_rad_s, TURNING_RAD_S)
    return centres_s


def sampling_times(event: Event) -> SampleTimes:
    """Return when the signals of the balance were sampled, as far as they are there, freed of transmission jitter."""
    sampled, by_message = dict[Signal, FloatArray](), dict[tuple[bytes, bytes, int], FloatArray]()
    for signal in BALANCE_SIGNALS:
        if (series := event.columns.get(signal)) is not None:
            message = series.t_ns.tobytes(), series.sequence.tobytes(), series.period_ns
            if message not in by_message:
                by_message[message] = sample_times_s(series, event.start_ns)
            sampled[signal] = by_message[message]
    return sampled


def measured_times(sampled: SampleTimes, event: Event, sensing: Sensing) -> SampleTimes:
    """Return the instants that the samples speak of: a speed of half a crank segment ago, a torque of a latency ago."""
    bias = sensing.bias
    engine_speed = event.columns[Signal.ENGINE_SPEED].value
    latency_s = {
        Signal.ENGINE_TORQUE: bias.torque_latency_s,
        Signal.CLUTCH1_PRESSURE: bias.pressure_latency_s,
        Signal.CLUTCH2_PRESSURE: bias.pressure_latency_s,
    }
    return {
        **sampled,
        **{signal: sampled[signal] - late_s for signal, late_s in latency_s.items()},
        Signal.ENGINE_SPEED: segment_centres_s(
            sampled[Signal.ENGINE_SPEED], engine_speed, sensing.input_side.crank_segment_rad
        ),
    }


def aligned(samples: EventSamples, sensing: Sensing, other: AlignedSignals | None = None) -> AlignedSignals | Reason:
    """Return samples on one clock and on the even grid that all signals reach, or why they cannot be.

    Latencies are those of ``sensing``. What does not depend on them is taken over from ``other``: the same samples with
    other latencies.
    """
    event = samples.event
    times = measured_times(samples.times, event, sensing)
    gaps = gaps_s(times, event, samples.row_s)
    if gaps is None:
        return Reason.TIME_UNSURE  # frames of one message came at one time
    noise_std = noise_of_signals(sensing.noise) if samples.row_s else {}
    if any(np.abs(event.columns[signal].value).max() > MOST_NOISES * std for signal, std in noise_std.items()):
        return Reason.OUT_OF_RANGE  # a cell may hold any number
    history_s = max([times_s[0] for times_s in times.values()])
    duration_s = (event.end_ns - event.start_ns) * NS_TO_S
    # Whole steps after the shift's start: a latency that is found more exactly must not move the points.
    grid_s = GRID_S * np.arange(math.ceil(history_s / GRID_S), math.ceil(duration_s / GRID_S), dtype=np.float64)
    if not len(grid_s):
        return Reason.NO_COMMON_TIME

    is_seen = np.ones(len(grid_s), np.bool_)
    for start_s, stop_s in gaps:
        is_seen[grid_s.searchsorted(start_s, "right") : grid_s.searchsorted(stop_s)] = False
    is_known = other is not None and len(other.grid_s) == len(grid_s)  # the same grid: it ends where the event ends
    wanted = _MOVED if is_known else BALANCE_SIGNALS
    if samples.row_s:
        on_grid = {signal: _resampled(samples, signal, times[signal], grid_s, noise_std[signal]) for signal in wanted}
    else:
        on_grid = {signal: Resampled(times[signal], event.columns[signal].value, grid_s) for signal in wanted}
    engine_speed, engine_torque = on_grid[Signal.ENGINE_SPEED], on_grid[Signal.ENGINE_TORQUE]
    pressure = (on_grid[Signal.CLUTCH1_PRESSURE], on_grid[Signal.CLUTCH2_PRESSURE])
    if other is not None and is_known:
        return replace(
            other, engine_speed=engine_speed, engine_torque=engine_torque, pressure=pressure, is_seen=is_seen
        )
    hub, first, second = on_grid[Signal.HUB_SPEED], on_grid[Signal.INPUT1_SPEED], on_grid[Signal.INPUT2_SPEED]
    is_one = samples.row_s and np.array_equal(hub.value, engine_speed.value)
    if is_one or (hub.curve is not None and engine_speed.curve is not None):
        hub = engine_speed  # nearer to it than two columns are, up to a row apart
    return AlignedSignals(
        grid_s=grid_s,
        engine_speed=engine_speed,
        engine_torque=engine_torque,
        hub_speed=hub,
        input_speed=(first, second),
        slip_rad_s=(hub.on_grid - first.on_grid, hub.on_grid - second.on_grid),
        pressure=pressure,
        expected_pa=(
            _expected_pa(event, Signal.CLUTCH1_PRESSURE_COMMAND, grid_s),
            _expected_pa(event, Signal.CLUTCH2_PRESSURE_COMMAND, grid_s),
        ),
        oil_k=samples.oil_k,
        is_seen=is_seen,
        row_s=samples.row_s,
    )


def _resampled(
    samples: EventSamples, signal: Signal, times_s: FloatArray, grid_s: FloatArray, noise_std: float
) -> Resampled:
    """Return one signal of a table on the grid: a curve through its rows, or straight between samples of a bus."""
    series, skew_s = samples.event.columns[signal], samples.skew_s
    if not is_of_rows(series):
        return Resampled(times_s, series.value, grid_s)
    own_age_std_s = FRAME_AGE_STD_S if skew_s >= samples.row_s else skew_s / math.sqrt(12.0)
    curve = RowCurve(times_s, series.value, noise_std, AGE_RATIO[signal] * skew_s, own_age_std_s)
    return Resampled(times_s, series.value, grid_s, curve)


def is_of_rows(series: Series) -> bool:
    """Return whether samples have neither counter nor schedule, as columns of a table, and answers to a tester."""
    return not series.period_ns and len(series.t_ns) > 1 and bool(series.sequence[0] < 0)


def _expected_pa(event: Event, command: Signal, grid_s: FloatArray) -> FloatArray | None:
    """Return the piston pressure to be expected from its command on the grid, a first-order lag behind it, or None."""
    series = event.columns.get(command)
    if series is None or not len(series.t_ns):
        return None
    expected_pa = np.interp(grid_s, sample_times_s(series, event.start_ns), series.value)
    _lag(expected_pa, GRID_S / COMMAND_LAG_S)
    return expected_pa


def readings(columns: Columns, signals: Iterable[Signal], origin_ns: int, at_s: FloatArray) -> dict[Signal, FloatArray]:
    """Return what signals read at rising times after a moment, without those of fewer than two samples."""
    return {
        signal: np.interp(at_s, (series.t_ns - origin_ns) * NS_TO_S, series.value)
        for signal in signals
        if (series := columns.get(signal)) is not None and len(series.t_ns) > 1
    }


@kernel
def _lag(values: FloatArray, share: float) -> None:
    """Have values follow themselves by a first-order lag, which takes up a share of what is missing at each."""
    for row in range(1, len(values)):
        values[row] = values[row - 1] + (values[row] - values[row - 1]) * share


UNSCHEDULED_PERIODS: Final = 1.5  # of the nominal one: what comes more seldom without schedule was asked for
MOST_NOISES: Final = 3e4  # of its sensor: no speed, torque or pressure is larger
MOST: Final = 1e9  # SI: likewise; a signal of a bus that is a floating-point number may say anything


def usable_signals(event: Event, sensing: Sensing) -> AlignedSignals | Reason:
    """Return the signals of a shift or engine run-up on one clock, or why they cannot be used."""
    samples = usable_samples(event)
    return samples if isinstance(samples, Reason) else aligned(samples, sensing)


def usable_samples(event: Event) -> EventSamples | Reason:
    """Return the samples of a shift or engine run-up, or why they cannot be used."""
    if event.has_whole_seconds or event.end_reason not in {EndReason.COMPLETE, EndReason.ABANDONED}:
        return Reason.WHOLE_SECONDS if event.has_whole_seconds else Reason.INTERRUPTED
    is_whole = event.end_reason is EndReason.COMPLETE  # what another event cut short may be seen in full, or not
    oil = event.columns.get(Signal.SUMP_TEMPERATURE)
    row_s = _row_s(event)
    if row_s:
        event = _without_near_rows(event, round(NEAR_ROW_PERIODS * row_s / NS_TO_S))
    sampled = sampling_times(event)
    if oil is None or not len(oil.t_ns) or len(sampled) < len(BALANCE_SIGNALS):
        return Reason.SIGNAL_MISSING if is_whole else Reason.INTERRUPTED
    duration_s = (event.end_ns - event.start_ns) * NS_TO_S
    for signal, times_s in sampled.items():
        series = event.columns[signal]
        if np.abs(series.value).max(initial=0.0) > MOST:
            return Reason.OUT_OF_RANGE
        own_s = series.period_ns * NS_TO_S or NOMINAL_PERIOD_S
        period_s = row_s if row_s and is_of_rows(series) else own_s
        inside_s = times_s[(times_s >= -2.0 * period_s) & (times_s <= duration_s)]
        edges_s = np.concatenate(([0.0], inside_s, [duration_s]))  # the first sample may be earlier than the event
        if len(inside_s) < 2 or np.diff(edges_s).max() > LOST_PERIODS * period_s:
            return _why_silent(event, sampled) if is_whole else Reason.INTERRUPTED
    oil_k = float(oil.value.mean())
    if not OIL_RANGE_K[0] <= oil_k <= OIL_RANGE_K[1]:
        return Reason.OUT_OF_RANGE
    of_torque, of_pressure = (event.columns[signal].t_ns for signal in (Signal.ENGINE_TORQUE, Signal.CLUTCH1_PRESSURE))
    skew_s = row_s if np.array_equal(of_torque, of_pressure) else min(row_s, ANSWER_S)  # asked values have own times
    return EventSamples(event=event, times=sampled, oil_k=oil_k, row_s=row_s, skew_s=skew_s)


def _why_silent(event: Event, sampled: Iterable[Signal]) -> Reason:
    """Return whether frames were late in a silence: then all signals stood still, and no counter proves a loss."""
    for series in (event.columns[signal] for signal in sampled):
        proven = (np.diff(series.sequence) - 1) % COUNTER_PERIOD + 1
        is_numbered = len(proven) > 0 and series.period_ns > 0 and series.sequence[0] >= 0
        stood_ns = np.diff(series.t_ns).max(initial=0)
        if not is_numbered or proven.max() > LOST_PERIODS or stood_ns <= LOST_PERIODS * series.period_ns:
            return Reason.FRAMES_MISSING
    return Reason.TIME_UNSURE


def _row_s(event: Event) -> float:
    """Return the time from row to row [s] of the table that an event is of; 0 if it is of a bus.

    What controllers tell whoever asks makes rows of its own: as slow as the slowest of them.
    """
    columns = [event.columns[signal] for signal in ROW_SIGNALS if signal in event.columns]
    balance_columns = [event.columns[signal] for signal in BALANCE_SIGNALS if signal in event.columns]
    if len(columns) < len(ROW_SIGNALS) or 0 not in [signal.period_ns for signal in balance_columns]:
        return 0.0
    if not (row_ns := row_period_ns(columns)):
        row_ns = max(
            (int(np.median(np.diff(signal.t_ns))) for signal in balance_columns if is_of_rows(signal)), default=0
        )
        if row_ns * NS_TO_S < UNSCHEDULED_PERIODS * NOMINAL_PERIOD_S:
            return 0.0  # messages of a bus whose database knows no cycle
    return max(row_ns * NS_TO_S, NOMINAL_PERIOD_S)


def _without_near_rows(event: Event, least_ns: int) -> Event:
    """Return an event of a table without rows that come too soon after the one before."""
    columns = dict(event.columns)
    for signal in BALANCE_SIGNALS:
        if (series := columns.get(signal)) is None or not is_of_rows(series):
            continue
        places, last_ns = list[int](), None
        for place, t_ns in enumerate(series.t_ns.tolist()):
            if last_ns is None or t_ns - last_ns >= least_ns:
                places.append(place)
                last_ns = t_ns
        columns[signal] = replace(
            series, t_ns=series.t_ns[places], sequence=series.sequence[places], value=series.value[places]
        )
    return replace(event, columns=columns)


def gaps_s(times: SampleTimes, event: Event, row_s: float = 0.0) -> FloatArray | None:
    """Return between which instants [s] two samples of any signal or more are missing in a row, shape (n, 2).

    None if the times of a signal do not rise.
    """
    duration_s = (event.end_ns - event.start_ns) * NS_TO_S
    gaps = [np.empty((0, 2))]
    for signal, times_s in times.items():
        period_s = event.columns[signal].period_ns * NS_TO_S or NOMINAL_PERIOD_S
        is_row = row_s and is_of_rows(event.columns[signal])
        longest_s = ROW_GAP_PERIODS * row_s if is_row else GAP_PERIODS * period_s
        steps_s = np.diff(times_s)
        if steps_s.min(initial=math.inf) <= 0.0:
            return None
        rows = np.flatnonzero(steps_s > longest_s)
        gaps.append(np.column_stack((times_s[rows], times_s[rows + 1])))
        if duration_s - times_s[-1] > longest_s:
            gaps.append(np.array([(times_s[-1], duration_s)]))
    return np.concatenate(gaps)
