"""The part of a shift that speaks of friction: exactly one clutch loaded and slipping."""

from dataclasses import dataclass

import numpy as np

from canlog.arrays import FloatArray

LOADED_PA = 0.25e5  # on-coming clutch: above its touch point by this much
RELEASED_PA = 0.10e5  # off-going clutch: not above its touch point by more than this, twice the sensor noise
SLIP_MIN_RAD_S = 0.8  # nearly three times the noise of the slip: slower may be locked; what is slow tells mu_S
FADE_S = 0.02  # after the release: contact of the off-going clutch fades within a few film time constants
MIN_WINDOW_S = 0.08  # eight samples; anything shorter is noise


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipWindow:
    """Grid rows ``first <= row < stop`` of the slip window and the sign of its slip."""

    first: int
    stop: int
    direction: float  # +1 hub faster, -1 hub slower


def find_window(
    grid_s: FloatArray, slip_rad_s: FloatArray, on_over_touch_pa: FloatArray, off_over_touch_pa: FloatArray
) -> SlipWindow | None:
    """Return the longest stretch in which only the on-coming clutch is loaded and slips one way, or None.

    Parameters
    ----------
    grid_s, slip_rad_s : (n,) array
        Even grid [s] and slip of the on-coming clutch [rad/s].
    on_over_touch_pa, off_over_touch_pa : (n,) array
        Piston pressures above the touch points [Pa].
    """
    usable = (on_over_touch_pa > LOADED_PA) & (off_over_touch_pa < RELEASED_PA)
    best: SlipWindow | None = None
    for direction in (1.0, -1.0):
        fits = np.concatenate(((False,), usable & (direction * slip_rad_s > SLIP_MIN_RAD_S), (False,)))
        edges = np.flatnonzero(fits[1:] != fits[:-1])
        for first, stop in edges.reshape(-1, 2):
            if best is None or stop - first > best.stop - best.first:
                best = SlipWindow(first=int(first), stop=int(stop), direction=direction)
    if best is None:
        return None
    step_s = float(grid_s[1] - grid_s[0])
    first = best.first + round(FADE_S / step_s)
    if (best.stop - first) * step_s < MIN_WINDOW_S:
        return None
    return SlipWindow(first=first, stop=best.stop, direction=best.direction)
