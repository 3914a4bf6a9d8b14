"""Hand-made signals for the finder of run-ups: the engine speed of one after the other, with gears and pressures."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from canlog.arrays import FloatArray, Series
from diag_service.diagnosis.columns import ColumnBatch, Signal

STEP_NS = 10_000_000
OPEN_PA = (0.0, 0.0)
CLOSED_PA = (4.0e5, 5.0e5)
IDLE_RAD_S = 80.0
RUN_UP_ROWS = 200  # 2 s
_SHARE = np.linspace(0.0, 1.0, RUN_UP_ROWS, endpoint=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A stretch of the stream: engine speed row by row, gear and pressures the same all along."""

    speed_rad_s: FloatArray
    gear: int = 0
    pressure_pa: tuple[float, float] = OPEN_PA


def run_up(pressure_pa: tuple[float, float] = OPEN_PA, *, top_rad_s: float = 400.0, gear: int = 0) -> Piece:
    """Return 2 s from idle through a peak back to idle."""
    swing = np.sin(np.pi * _SHARE) * (top_rad_s - IDLE_RAD_S)
    return Piece(speed_rad_s=IDLE_RAD_S + swing, gear=gear, pressure_pa=pressure_pa)


def idle(rows: int = 100, *, gear: int = 0, pressure_pa: tuple[float, float] = OPEN_PA) -> Piece:
    return Piece(speed_rad_s=np.full(rows, IDLE_RAD_S), gear=gear, pressure_pa=pressure_pa)


def columns_of(pieces: Sequence[Piece]) -> dict[Signal, Series]:
    """Return the pieces one after the other: speed, gears and pressures in three messages, 1 ms apart."""
    lengths = [len(piece.speed_rad_s) for piece in pieces]
    rows = np.arange(sum(lengths), dtype=np.int64)

    def series(values: FloatArray, message: int) -> Series:
        return Series(t_ns=rows * STEP_NS + message * 1_000_000, sequence=rows, value=values, period_ns=STEP_NS)

    gear = np.repeat([float(piece.gear) for piece in pieces], lengths)
    columns = {
        Signal.ENGINE_SPEED: series(np.concatenate([piece.speed_rad_s for piece in pieces]), 0),
        Signal.CURRENT_GEAR: series(gear, 2),
        Signal.TARGET_GEAR: series(gear, 2),
    }
    for index, signal in enumerate((Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE)):
        columns[signal] = series(np.repeat([piece.pressure_pa[index] for piece in pieces], lengths), 1)
    return columns


def batch_between(columns: dict[Signal, Series], start_ns: int, stop_ns: int) -> ColumnBatch | None:
    """Return what is on the bus in a stretch of time, None if nothing; every 37th pressure comes with a bad frame."""
    cut = {signal: series.between(start_ns, stop_ns) for signal, series in columns.items()}
    present = {signal: series for signal, series in cut.items() if len(series.t_ns)}
    if not present:
        return None
    pressure = cut[Signal.CLUTCH1_PRESSURE]
    return ColumnBatch(
        columns=present,
        watermark_ns=max(int(series.t_ns[-1]) for series in present.values()),
        bad_frame_ns=pressure.t_ns[pressure.sequence % 37 == 0],
    )


def whole_batch(pieces: Sequence[Piece], *, breaks_before: bool = False) -> ColumnBatch:
    """Return the pieces as one batch without bad frames."""
    columns = columns_of(pieces)
    latest_ns = max(int(series.t_ns[-1]) for series in columns.values())
    return ColumnBatch(columns=columns, watermark_ns=latest_ns, breaks_before=breaks_before)
