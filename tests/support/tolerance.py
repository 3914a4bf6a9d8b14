"""How well a drive keeps to its speed trace, as UN GTR 15 (WLTP), Annex 6, paragraph 2.6.8.3.1 has it.

At every instant the speed may lie 2 km/h above the highest and 2 km/h below the lowest point of the trace within
1 s before and after.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray
from clutch_model.errors import DomainError
from clutch_model.units import m_s_from_km_h
from ecu_emulator.driving.traffic import SpeedTrace

SPEED_TOLERANCE_M_S: Final = float(m_s_from_km_h(2.0))
TIME_TOLERANCE_S: Final = 1.0
_ROUNDING_M_S: Final = 1e-9  # of a speed exactly on the limit


def speed_limits_m_s(trace: SpeedTrace, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest speed allowed at each instant, each (n,).

    Parameters
    ----------
    t_s : (n,) array
        Times of the trace; before its beginning and behind its end it stays as it is there.
    """
    ends_m_s = [
        np.interp(t_s + shift_s, trace.t_s, trace.speed_m_s) for shift_s in (-TIME_TOLERANCE_S, TIME_TOLERANCE_S)
    ]
    lowest, highest = np.minimum(*ends_m_s), np.maximum(*ends_m_s)
    # Between its points the trace is straight: what is left are the points within the second before and after.
    first = np.searchsorted(trace.t_s, t_s - TIME_TOLERANCE_S)
    stop = np.searchsorted(trace.t_s, t_s + TIME_TOLERANCE_S, side="right")
    for offset in range(int(np.max(stop - first, initial=0))):
        inside = np.flatnonzero(first + offset < stop)
        point_m_s = trace.speed_m_s[first[inside] + offset]
        lowest[inside] = np.minimum(lowest[inside], point_m_s)
        highest[inside] = np.maximum(highest[inside], point_m_s)
    return lowest - SPEED_TOLERANCE_M_S, highest + SPEED_TOLERANCE_M_S


def is_within_tolerance(trace: SpeedTrace, t_s: FloatArray, speed_m_s: FloatArray) -> npt.NDArray[np.bool_]:
    """Return for each instant, shape (n,), whether a driven speed is one that the trace allows."""
    low_m_s, high_m_s = speed_limits_m_s(trace, t_s)
    return (low_m_s - _ROUNDING_M_S <= speed_m_s) & (speed_m_s <= high_m_s + _ROUNDING_M_S)


def share_within_tolerance(trace: SpeedTrace, t_s: FloatArray, speed_m_s: FloatArray) -> float:
    """Return the share of the driven time, 0..1, in which the speed is one that the trace allows.

    Parameters
    ----------
    t_s, speed_m_s : (n,) array
        Times, increasing, and the speeds driven; each instant stands for the time until the next one.

    Raises
    ------
    DomainError
        If there are fewer than two instants, times do not increase, or a speed is not finite.
    """
    if len(t_s) < 2 or len(t_s) != len(speed_m_s):
        raise DomainError(f"a driven speed needs two instants or more, got {len(t_s)} times, {len(speed_m_s)} speeds")
    durations_s = np.diff(t_s)
    if not (np.all(durations_s > 0.0) and np.all(np.isfinite(speed_m_s))):
        raise DomainError("times of a driven speed must increase, and its speeds be finite")
    is_within = is_within_tolerance(trace, t_s[:-1], speed_m_s[:-1])
    return float(durations_s[is_within].sum() / durations_s.sum())
