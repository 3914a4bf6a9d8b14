"""The signals of one event on one clock and one even grid: when samples were taken, and what they read in between."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array, Series
from canlog.jit import kernel
from clutch_model.calibration import Calibration, SensorNoise
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Columns, Signal
from diag_service.diagnosis.events import Event

NS_TO_S = 1e-9
GRID_S = 2e-3  # five points per CAN sample; a finer grid moves friction by a tenth of its deviation
TURNING_RAD_S = 58.0  # 554 rpm: below any idle; there a starter may turn the engine, which no torque reading tells
END_COUNT = 30  # samples, of which one is nearly on time; an event is cut that much wider than its slip window
COMMAND_LAG_S = 0.025  # from commanded to piston pressure: solenoid and feed orifice; docs/model.md, hydraulics

FRAME_AGE_STD_S = 3e-3  # of a value that was sent every 10 ms before it was asked for
ANSWER_S = 0.025  # after a request some controller reads a value, nobody knows when
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


def noise_of_signals(noise: SensorNoise) -> dict[Signal, float]:
    """Return the noise of the sensor of each signal of the balance."""
    return {
        Signal.ENGINE_SPEED: noise.engine_speed_rad_s,
        Signal.ENGINE_TORQUE: noise.engine_torque_nm,
        Signal.HUB_SPEED: noise.hub_speed_rad_s,
        **dict.fromkeys((Signal.INPUT1_SPEED, Signal.INPUT2_SPEED), noise.input_speed_rad_s),
        **dict.fromkeys((Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE), noise.pressure_pa),
    }


Sums = Sequence[FloatArray]
SampleTimes = Mapping[Signal, FloatArray]
"""When each signal of the balance was sampled [s] after the start of its event."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """How the samples of an event are rows of a table, or answers to a tester; none of it where ``period_s`` is 0."""

    period_s: float = 0.0  # from row to row
    skew_s: float = 0.0  # by up to so much the columns are apart
    own_age_std_s: float = 0.0  # of the age of one value, whatever that of others is
    noise_std: Mapping[Signal, float] = field(default_factory=dict)  # of sensors


NO_ROWS = Rows()


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
    curve: "RowCurve | None"  # through few rows, whose points stand for samples; None: each sample for itself

    def __init__(
        self, times_s: FloatArray, value: FloatArray, grid_s: FloatArray, curve: "RowCurve | None" = None
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
        found = []
        for of_rows, rows in zip(weights, pieces, strict=True):
            place, share = self.left[rows] - self.left[rows][0], self.share[rows]
            shares, row = np.zeros((len(place), place[-1] + 2)), np.arange(len(place))
            shares[row, place], shares[row, place + 1] = 1.0 - share, share
            found.append(of_rows @ shares)
        return tuple(found)

    def shared(self, one: Sums, other: Sums, rows: Sequence[slice], *, is_followed: bool = False) -> list[FloatArray]:
        """Return covariances of two sums with weights of `to_samples`, in variances of the sensor."""
        if self.curve is None:
            return [first @ second.T for first, second in zip(one, other, strict=True)]
        of_points = self.curve.followed if is_followed else self.curve.covariance
        return [
            first @ of_points(self.left[piece][0], self.left[piece][-1] + 2) @ second.T
            for first, second, piece in zip(one, other, rows, strict=True)
        ]

    def around_samples(
        self, values: FloatArray, places: Sequence[slice], pieces: Sequence[slice]
    ) -> tuple[FloatArray, ...]:
        """Return values as means around the samples of `to_samples`, shape (n,) each; ``places`` are of the pieces."""
        found = []
        for place, rows in zip(places, pieces, strict=True):
            left, share, of_rows = self.left[rows] - self.left[rows][0], self.share[rows], values[place]
            both, count = np.concatenate([left, left + 1]), left[-1] + 2
            weight = np.bincount(both, np.concatenate([1.0 - share, share]), count)
            total = np.bincount(both, np.concatenate([(1.0 - share) * of_rows, share * of_rows]), count)
            found.append(total / np.maximum(weight, _NO_WEIGHT))
        return tuple(found)


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
    return {
        signal: sample_times_s(series, event.start_ns)
        for signal in BALANCE_SIGNALS
        if (series := event.columns.get(signal)) is not None
    }


def measured_times(sampled: SampleTimes, event: Event, calibration: Calibration) -> SampleTimes:
    """Return the instants that the samples speak of: a speed of half a crank segment ago, a torque of a latency ago."""
    bias = calibration.bias
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
            sampled[Signal.ENGINE_SPEED], engine_speed, calibration.input_side.crank_segment_rad
        ),
    }


def align(
    times: SampleTimes,
    event: Event,
    oil_k: float,
    gaps_s: FloatArray,
    other: AlignedSignals | None = None,
    rows: Rows = NO_ROWS,
) -> AlignedSignals:
    """Return the signals of an event on the even grid that all of them reach.

    Parameters
    ----------
    times
        Of every signal of the balance, strictly increasing.
    event
        Its columns hold every signal of the balance.
    oil_k
        Temperature of the oil [K].
    gaps_s : (n, 2) array
        Between which instants [s] samples are missing, on the clock of ``times``.
    other
        The same event as another calibration has it: what no calibration moves is taken over from there.
    rows
        Of the table that its signals are columns of.
    """
    history_s = max(one[0] for one in times.values())
    duration_s = (event.end_ns - event.start_ns) * NS_TO_S
    # Whole steps after the shift's start: a latency that is found more exactly must not move the points.
    grid_s = GRID_S * np.arange(math.ceil(history_s / GRID_S), math.ceil(duration_s / GRID_S), dtype=np.float64)

    is_seen = np.ones(len(grid_s), np.bool_)
    for start_s, stop_s in gaps_s:
        is_seen[grid_s.searchsorted(start_s, "right") : grid_s.searchsorted(stop_s)] = False
    is_known = other is not None and len(other.grid_s) == len(grid_s)  # the same grid: it ends where the event ends
    wanted = _MOVED if is_known else BALANCE_SIGNALS
    if rows.period_s:
        on_grid = {one: _resampled(one, times[one], event.columns[one], grid_s, rows) for one in wanted}
    else:
        on_grid = {one: Resampled(times[one], event.columns[one].value, grid_s) for one in wanted}
    engine_speed, engine_torque = on_grid[Signal.ENGINE_SPEED], on_grid[Signal.ENGINE_TORQUE]
    pressure = (on_grid[Signal.CLUTCH1_PRESSURE], on_grid[Signal.CLUTCH2_PRESSURE])
    if other is not None and is_known:
        return replace(
            other, engine_speed=engine_speed, engine_torque=engine_torque, pressure=pressure, is_seen=is_seen
        )
    hub, first, second = (on_grid[one] for one in (Signal.HUB_SPEED, Signal.INPUT1_SPEED, Signal.INPUT2_SPEED))
    is_one = rows.period_s and np.array_equal(hub.value, engine_speed.value)
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
        oil_k=oil_k,
        is_seen=is_seen,
        row_s=rows.period_s,
    )


def _resampled(signal: Signal, times_s: FloatArray, series: Series, grid_s: FloatArray, rows: Rows) -> Resampled:
    """Return one signal on the grid: a curve through few rows, or straight between samples of a bus."""
    if not is_of_rows(series):
        return Resampled(times_s, series.value, grid_s)
    age_std_s = AGE_RATIO[signal] * rows.skew_s
    curve = RowCurve(times_s, series.value, rows.noise_std[signal], age_std_s, rows.own_age_std_s)
    return Resampled(times_s, series.value, grid_s, curve)


def is_of_rows(series: Series) -> bool:
    """Return whether samples have neither counter nor schedule, as columns of a table, and answers to a tester."""
    return not series.period_ns and len(series.t_ns) > 1 and bool(series.sequence[0] < 0)


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

        own = np.eye(len(self.value), stop - first, -first)
        by_age = self._moved_by_age[first:stop]
        found = cho_solve_banded((self._root, False), own)[first:stop] + np.outer(by_age, by_age)
        return np.asarray(found / self._noise_std**2)

    def followed(self, first: int, stop: int) -> FloatArray:
        """Return likewise how far points are off where they are high: by what noise of rows the loose walk lets in."""
        own = self._by_rows[first:stop] / self._noise_std
        return np.asarray((1.0 - 1.0 / WALK_RATIO) * own @ own.T)


def _slope_walk(times_s: FloatArray, value: FloatArray, noise_std: float) -> FloatArray:
    """Return by how much the variance of a column's slope grows in a second between its rows, shape (n - 1,)."""
    periods_s = np.diff(times_s)
    if len(value) < 3:
        return np.full(1, (np.ptp(value) + noise_std) ** 2 / periods_s[0] ** 3)
    spans_s = periods_s[1:] + periods_s[:-1]
    found = 3.0 * np.diff(np.diff(value) / periods_s) ** 2 / spans_s
    found = np.pad(found, 2, mode="edge")
    near = (found[:-3] + found[1:-2] + found[2:-1] + found[3:]) * (WALK_RATIO / 4.0)
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
