"""Synthetic plant rows: smooth made-up motion, so that the stages after the plant can be tested without it."""

from collections.abc import Sequence

import numpy as np

from canlog.arrays import FloatArray
from ecu_emulator.plant.state import Col


def made_up_rows(count: int, *, seed: int = 7) -> FloatArray:
    """Return rows 0, 1, ... ms with a different smooth course in every column and a crank that turns."""
    t_s = np.arange(count) / 1000.0
    rng = np.random.default_rng(seed)
    base, swing, rate = rng.uniform(50.0, 300.0, (3, len(Col)))
    rows: FloatArray = base + 0.1 * swing * np.sin(rate / 40.0 * t_s[:, np.newaxis])
    rows[:, Col.T_S] = t_s
    rows[:, Col.ENGINE_SPEED] = 200.0 + 40.0 * np.sin(3.0 * t_s)
    rows[:, Col.CRANK_ANGLE] = 200.0 * t_s + 40.0 / 3.0 * (1.0 - np.cos(3.0 * t_s))
    rows[:, Col.CURRENT_GEAR] = rows[:, Col.TARGET_GEAR] = 1.0
    rows[:, [Col.ROUTINE, Col.REV]] = 0.0
    rows[:, Col.DRIVE_STATE : Col.ENGINE_STATE + 1] = 0.0  # on the shift cycles
    return rows


def with_shift(rows: FloatArray, start_ms: int, stop_ms: int, from_gear: int, to_gear: int) -> FloatArray:
    """Return a copy with one gear change in it; it holds the new gear to the end."""
    changed = rows.copy()
    changed[:stop_ms, Col.CURRENT_GEAR] = np.where(
        np.arange(stop_ms) < start_ms, rows[:stop_ms, Col.CURRENT_GEAR], from_gear
    )
    changed[start_ms:, Col.TARGET_GEAR] = to_gear
    changed[stop_ms:, Col.CURRENT_GEAR] = to_gear
    return changed


def with_revs(rows: FloatArray, revs: Sequence[tuple[int, int, int]]) -> FloatArray:
    """Return a copy in which revs (first ms, ms after the last, stage of the routine) take place."""
    changed = rows.copy()
    for number, (start_ms, stop_ms, stage) in enumerate(revs, start=1):
        changed[start_ms:stop_ms, Col.ROUTINE] = stage
        changed[start_ms:stop_ms, Col.REV] = number
    return changed
