"""The signals of one shift or engine run-up on one clock and one even grid, as the torque balance needs them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import kernel
from clutch_model.calibration import Calibration
from diag_service.diagnosis.alignment.sampling import (
    GRID_S,
    NS_TO_S,
    Interpolation,
    sample_times_s,
    segment_centres_s,
)
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Signal
from diag_service.diagnosis.events import Event

COMMAND_LAG_S = 0.025  # from commanded to piston pressure: solenoid and feed orifice; docs/model.md, hydraulics

SampleTimes = Mapping[Signal, FloatArray]
"""When each signal of the balance was sampled [s] after the start of its event."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Resampled:
    """One signal of a shift: when it was sampled, what it read, and the way to the even grid."""

    times_s: FloatArray  # (n,) after the start of the shift
    value: FloatArray  # (n,)
    interpolation: Interpolation
    on_grid: FloatArray  # (len(grid),)


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignedSignals:
    """Everything measured in one shift, on one clock that starts with the shift."""

    grid_s: FloatArray
    engine_speed: Resampled
    engine_torque: Resampled
    hub_speed: Resampled
    input_speed: tuple[Resampled, Resampled]
    pressure: tuple[Resampled, Resampled]
    expected_pa: tuple[FloatArray | None, FloatArray | None]  # on the grid, from the command: free of sensor noise
    oil_k: float

    def slip_rad_s(self, clutch: int) -> FloatArray:
        """Return the slip of clutch 1 or 2 on the grid: hub minus input shaft."""
        return self.hub_speed.on_grid - self.input_speed[clutch - 1].on_grid


def sampling_times(event: Event) -> SampleTimes:
    """Return when the signals of the balance were sampled, as far as they are there, freed of transmission jitter."""
    return {
        signal: sample_times_s(event.columns[signal], event.start_ns)
        for signal in BALANCE_SIGNALS
        if signal in event.columns
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


def align(times: SampleTimes, event: Event, oil_k: float) -> AlignedSignals:
    """Return the signals of an event on the even grid that all of them reach.

    Parameters
    ----------
    times
        Of every signal of the balance, strictly increasing.
    event
        Its columns hold every signal of the balance.
    oil_k
        Temperature of the oil [K].
    """
    history_s = max(one[0] for one in times.values())
    duration_s = (event.end_ns - event.start_ns) * NS_TO_S
    # Whole steps after the shift's start: a latency that is found more exactly must not move the points.
    grid_s = GRID_S * np.arange(math.ceil(history_s / GRID_S), math.ceil(duration_s / GRID_S), dtype=np.float64)
    on_grid = {signal: _resampled(one, event.columns[signal].value, grid_s) for signal, one in times.items()}
    return AlignedSignals(
        grid_s=grid_s,
        engine_speed=on_grid[Signal.ENGINE_SPEED],
        engine_torque=on_grid[Signal.ENGINE_TORQUE],
        hub_speed=on_grid[Signal.HUB_SPEED],
        input_speed=(on_grid[Signal.INPUT1_SPEED], on_grid[Signal.INPUT2_SPEED]),
        pressure=(on_grid[Signal.CLUTCH1_PRESSURE], on_grid[Signal.CLUTCH2_PRESSURE]),
        expected_pa=(
            _expected_pa(event, Signal.CLUTCH1_PRESSURE_COMMAND, grid_s),
            _expected_pa(event, Signal.CLUTCH2_PRESSURE_COMMAND, grid_s),
        ),
        oil_k=oil_k,
    )


def compile_alignment() -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    ends, one = np.array([0.0, 1.0]), np.zeros((1, 2))
    Interpolation.between(ends, ends).to_samples(one)
    _lag_behind(ends, 1.0, np.empty(2))


def _resampled(times_s: FloatArray, value: FloatArray, grid_s: FloatArray) -> Resampled:
    interpolation = Interpolation.between(times_s, grid_s)
    return Resampled(times_s=times_s, value=value, interpolation=interpolation, on_grid=interpolation.to_grid(value))


def _expected_pa(event: Event, command: Signal, grid_s: FloatArray) -> FloatArray | None:
    """Return the piston pressure to be expected from its command on the grid, a first-order lag behind it, or None."""
    series = event.columns.get(command)
    if series is None or not len(series.t_ns):
        return None
    commanded_pa = np.interp(grid_s, sample_times_s(series, event.start_ns), series.value)
    expected_pa = np.empty_like(commanded_pa)
    _lag_behind(commanded_pa, GRID_S / COMMAND_LAG_S, expected_pa)
    return expected_pa


@kernel
def _lag_behind(target: FloatArray, share: float, lagging: FloatArray) -> None:
    value = target[0]
    for row in range(len(target)):
        value += (target[row] - value) * share
        lagging[row] = value
