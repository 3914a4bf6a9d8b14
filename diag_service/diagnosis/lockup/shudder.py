"""Whether slip swings by itself: a narrow line between 5 and 20 Hz while the lock-up clutch is let slip.

A driveline swings at its own frequency, whatever turns it on: friction that falls with the slip feeds it until the
clutch sticks in every swing, a rough road only rings it, and an engine with a weak cylinder swings at its own orders.
"""

from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration
from clutch_model.units import NS_PER_S
from clutch_results.event_kinds import Shudder
from diag_service.diagnosis.lockup import blocks

BAND_HZ: Final = (5.0, 20.0)
STEP_S: Final = 0.01
SLOWEST_S: Final = 0.02  # from sample to sample: half of its rate is above the band
WINDOW: Final = 128  # steps
LINE_HZ: Final = 2.0  # to either side of a line: what a window of this length makes of it
LEAST_SHARE: Final = 0.6  # of what swings in the band
LEAST_SWING_RATIO: Final = 0.25  # amplitude of the line over mean slip
LEAST_SWING_RAD_S: Final = 0.8
ORDERS: Final = (0.5, 1.0)  # of the engine, that fall into the band
ORDER_HZ: Final = 1.0
ENGINE_SHARE: Final = 0.6  # engine's swing over the turbine's: it has several times the inertia, so it swings less


def shudder(samples: blocks.Samples, calibration: Calibration) -> Shudder | None:
    """Return what swings in a stretch; None where signals are too slow, or the clutch never slips for long enough."""
    at_s = (samples.t_ns - samples.t_ns[0]) / NS_PER_S
    if float(np.median(np.diff(at_s))) > SLOWEST_S:
        return None
    grid_s = np.arange(0.0, at_s[-1], STEP_S)
    slip = np.interp(grid_s, at_s, samples.slip_rad_s)
    engine = np.interp(grid_s, at_s, samples.engine_rad_s)
    pressed_pa = np.interp(grid_s, at_s, samples.pressure_pa) - calibration.clutches[0].touch_pressure_pa
    starts = np.arange(0, len(grid_s) - WINDOW + 1, WINDOW // 2)
    if not len(starts):
        return None
    rows = starts[:, None] + np.arange(WINDOW)
    slips, mean = slip[rows], slip[rows].mean(axis=1)
    trend = np.linspace(-0.5, 0.5, WINDOW)
    rise = slips @ trend / (trend @ trend)
    held = (
        (pressed_pa[rows].min(axis=1) > blocks.LEAST_PRESSURE_PA)
        & (mean > blocks.LEAST_SLIP_RAD_S)
        & (mean < blocks.MOST_SLIP_RAD_S)
        & (np.abs(rise) < blocks.MOST_SLIP_RATE_RAD_S2 * WINDOW * STEP_S)
    )
    if not held.any():
        return None
    mean, engine = mean[held], engine[rows][held]
    turning_hz = engine.mean(axis=1) / (2.0 * np.pi)
    frequency_hz = np.fft.rfftfreq(WINDOW, STEP_S)
    power = _power(slips[held])
    in_band = (frequency_hz >= BAND_HZ[0]) & (frequency_hz <= BAND_HZ[1])
    noise = calibration.noise.engine_speed_rad_s**2 + calibration.noise.input_speed_rad_s**2
    floor = 2.0 * noise / WINDOW
    swing = np.maximum(power - floor, 0.0) * in_band
    line_hz = frequency_hz[swing.argmax(axis=1)]
    on_line = np.abs(frequency_hz - line_hz[:, None]) <= LINE_HZ
    line = (swing * on_line).sum(axis=1)
    total = swing.sum(axis=1)
    amplitude = np.sqrt(2.0 * line)
    by_engine = np.abs(line_hz - np.outer(ORDERS, turning_hz)).min(axis=0) < ORDER_HZ
    by_engine &= (_power(engine) * on_line).sum(axis=1) > ENGINE_SHARE**2 * (
        _power(engine - slips[held]) * on_line
    ).sum(axis=1)
    seen = (
        (line > LEAST_SHARE * total)
        & (amplitude > np.maximum(LEAST_SWING_RATIO * mean, LEAST_SWING_RAD_S))
        & ~by_engine
    )
    return Shudder(
        window_count=len(mean),
        seen_count=int(np.count_nonzero(seen)),
        frequency_hz=float(np.median(line_hz[seen])) if seen.any() else None,
        amplitude_rad_s=float(np.sqrt(total.mean())),
    )


def _power(rows: FloatArray) -> FloatArray:
    """Return by frequency how rows vary about a parabola, so that the sum of a row is that variance."""
    taper = np.hanning(WINDOW)
    slow, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, WINDOW), 3))
    rest = rows - rows @ slow @ slow.T
    found: FloatArray = 2.0 * np.abs(np.fft.rfft(rest * taper)) ** 2 / (WINDOW * (taper @ taper))
    return found
