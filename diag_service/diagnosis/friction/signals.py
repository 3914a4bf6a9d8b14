"""The signals of one shift as the estimator needs them, or the reason why they will not do."""

import math
from dataclasses import dataclass

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import kernel
from clutch_model.calibration import Calibration
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Signal
from diag_service.diagnosis.events import EndReason, RevEvent, ShiftEvent
from diag_service.diagnosis.friction.sampling import GRID_S, NS_TO_S, Interpolation, sample_times_s, segment_centres_s
from diag_service.diagnosis.records import Reason

MAX_GAP_PERIODS = 2.5  # one missing frame is bridged by interpolation, two are not
NOMINAL_PERIOD_S = 0.01  # of signals whose message states no cycle time
COMMAND_LAG_S = 0.025  # from commanded to piston pressure: solenoid and feed orifice
OIL_RANGE_K = (233.15, 443.15)  # -40..170 degC: where the fluid's viscosity law holds


@dataclass(frozen=True, slots=True, kw_only=True)
class Samples:
    """One signal of a shift: when it was sampled, what it read, and the way to the even grid."""

    times_s: FloatArray  # (n,) after the origin of the shift
    value: FloatArray  # (n,)
    interpolation: Interpolation
    on_grid: FloatArray  # (len(grid),)


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftSignals:
    """Everything measured in one shift, on one clock that starts at the shift's first sample."""

    grid_s: FloatArray
    engine_speed: Samples
    engine_torque: Samples
    hub_speed: Samples
    input_speed: tuple[Samples, Samples]
    pressure: tuple[Samples, Samples]
    expected_pa: tuple[FloatArray | None, FloatArray | None]  # on the grid, from the command: free of sensor noise
    oil_k: float

    def slip_rad_s(self, clutch: int) -> FloatArray:
        """Return the slip of clutch 1 or 2 on the grid: hub minus input shaft."""
        return self.hub_speed.on_grid - self.input_speed[clutch - 1].on_grid


def gather(event: ShiftEvent | RevEvent, calibration: Calibration) -> ShiftSignals | Reason:
    """Return the signals of a shift or rev on one clock, or why they cannot be used."""
    if event.end_reason is not EndReason.COMPLETE:
        return Reason.INTERRUPTED
    oil = event.columns.get(Signal.SUMP_TEMPERATURE)
    series = {signal: event.columns[signal] for signal in BALANCE_SIGNALS if signal in event.columns}
    if oil is None or not len(oil.t_ns) or len(series) < len(BALANCE_SIGNALS):
        return Reason.SIGNAL_MISSING
    duration_s = (event.end_ns - event.start_ns) * NS_TO_S
    times = {signal: sample_times_s(one, event.start_ns) for signal, one in series.items()}
    if any(_has_gap(times[signal], one.period_ns, duration_s) for signal, one in series.items()):
        return Reason.FRAMES_MISSING
    oil_k = float(np.mean(oil.value))
    if not OIL_RANGE_K[0] <= oil_k <= OIL_RANGE_K[1]:
        return Reason.OUT_OF_RANGE
    engine = series[Signal.ENGINE_SPEED]
    times[Signal.ENGINE_SPEED] = segment_centres_s(
        times[Signal.ENGINE_SPEED], engine.value, calibration.input_side.crank_segment_rad
    )
    bias = calibration.bias
    times[Signal.ENGINE_TORQUE] = times[Signal.ENGINE_TORQUE] - bias.torque_latency_s
    for pressure in (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE):
        times[pressure] = times[pressure] - bias.pressure_latency_s
    if any(np.any(np.diff(one) <= 0.0) for one in times.values()):
        return Reason.OUT_OF_RANGE  # time runs backwards inside a segment: the receive clock is not to be trusted
    history_s = max(one[0] for one in times.values())
    # Whole steps after the shift's start: a latency that is found more exactly must not move the points.
    grid_s = GRID_S * np.arange(math.ceil(history_s / GRID_S), math.ceil(duration_s / GRID_S), dtype=np.float64)
    samples = {signal: _resampled(times[signal], one.value, grid_s) for signal, one in series.items()}
    return ShiftSignals(
        grid_s=grid_s,
        engine_speed=samples[Signal.ENGINE_SPEED],
        engine_torque=samples[Signal.ENGINE_TORQUE],
        hub_speed=samples[Signal.HUB_SPEED],
        input_speed=(samples[Signal.INPUT1_SPEED], samples[Signal.INPUT2_SPEED]),
        pressure=(samples[Signal.CLUTCH1_PRESSURE], samples[Signal.CLUTCH2_PRESSURE]),
        expected_pa=(
            _expected_pa(event, Signal.CLUTCH1_PRESSURE_COMMAND, grid_s),
            _expected_pa(event, Signal.CLUTCH2_PRESSURE_COMMAND, grid_s),
        ),
        oil_k=oil_k,
    )


def _resampled(times_s: FloatArray, value: FloatArray, grid_s: FloatArray) -> Samples:
    interpolation = Interpolation.between(times_s, grid_s)
    return Samples(times_s=times_s, value=value, interpolation=interpolation, on_grid=interpolation.to_grid(value))


def _expected_pa(event: ShiftEvent | RevEvent, command: Signal, grid_s: FloatArray) -> FloatArray | None:
    """Return the piston pressure to be expected from its command on the grid, a first-order lag behind it, or None."""
    series = event.columns.get(command)
    if series is None or not len(series.t_ns):
        return None
    commanded_pa = np.interp(grid_s, sample_times_s(series, event.start_ns), series.value)
    expected_pa = np.empty_like(commanded_pa)
    _lag_behind(commanded_pa, GRID_S / COMMAND_LAG_S, expected_pa)
    return expected_pa


def compile_signals() -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    ends, one = np.array([0.0, 1.0]), np.zeros((1, 2))
    Interpolation.between(ends, ends).to_samples(one)
    _lag_behind(ends, 1.0, np.empty(2))


@kernel
def _lag_behind(target: FloatArray, share: float, lagging: FloatArray) -> None:
    value = target[0]
    for row in range(len(target)):
        value += (target[row] - value) * share
        lagging[row] = value


def _has_gap(times_s: FloatArray, period_ns: int, duration_s: float) -> bool:
    """Tell whether two samples in a row are missing between the shift's start and its end; late ones are not."""
    period_s = period_ns * NS_TO_S or NOMINAL_PERIOD_S
    inside_s = times_s[(times_s >= -2.0 * period_s) & (times_s <= duration_s)]
    if len(inside_s) < 2:
        return True
    steps_s = np.diff(inside_s, prepend=min(0.0, float(inside_s[0])), append=max(duration_s, float(inside_s[-1])))
    return bool(steps_s.max() > MAX_GAP_PERIODS * period_s)
