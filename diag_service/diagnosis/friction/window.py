"""The part of a shift that speaks of friction, and the test functions and polynomials on it."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.alignment import GRID_S

SLIP_DEGREE = 5  # a shift controller's slip profile: smooth start, smooth end
LOADED_PA = 0.25e5  # on-coming clutch: above its touch point by this much
RELEASED_PA = 0.10e5  # off-going clutch: not above its touch point by more than this, twice the sensor noise
SLIP_MIN_RAD_S = 0.8  # nearly three times the noise of the slip: slower may be locked; what is slow tells mu_S
FADE_S = 0.02  # after the release: contact of the off-going clutch fades within a few film time constants
MIN_WINDOW_S = 0.08  # eight samples; anything shorter is noise


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipWindow:
    """Grid rows ``first <= row < stop`` of the slip window."""

    first: int
    stop: int

    @property
    def rows(self) -> slice:
        """The rows, as arrays over the grid take them."""
        return slice(self.first, self.stop)


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
    stretches: list[list[int]] = []
    for direction in (1.0, -1.0):
        fits = np.concatenate(((False,), usable & (direction * slip_rad_s > SLIP_MIN_RAD_S), (False,)))
        stretches += np.flatnonzero(fits[1:] != fits[:-1]).reshape(-1, 2).tolist()
    if not stretches:
        return None
    first, stop = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
    step_s = float(grid_s[1] - grid_s[0])
    first += round(FADE_S / step_s)
    return SlipWindow(first=first, stop=stop) if (stop - first) * step_s >= MIN_WINDOW_S else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """Sines that vanish at both ends of the window, and their derivatives, times the grid step."""

    value: FloatArray  # (k, len(grid))
    rate: FloatArray  # (k, len(grid))


def sines(grid_s: FloatArray, window: SlipWindow, count: int) -> Weights:
    """Return ``count`` sine test functions on the window; zero outside."""
    value = np.zeros((count, len(grid_s)))
    rate = np.zeros_like(value)
    inside = window.rows
    start_s, length_s = grid_s[window.first], grid_s[window.stop - 1] - grid_s[window.first]
    order = np.arange(1, count + 1)[:, None]
    angle = order * np.pi * (grid_s[inside] - start_s) / length_s
    value[:, inside] = np.sin(angle) * GRID_S
    rate[:, inside] = np.cos(angle) * order * np.pi / length_s * GRID_S
    rate[:, [window.first, window.stop - 1]] *= 0.5  # trapezoid
    return Weights(value=value, rate=rate)


def smoothed(values: FloatArray, window: SlipWindow, degree: int) -> FloatArray:
    """Return the values, shape (..., len(grid)), with a polynomial fit in place of those inside the window.

    Fitting is symmetric: weights smoothed and values as they are give the same sums as weights as they are and values
    smoothed, as long as the weights vanish outside the window.
    """
    inside = window.rows
    basis = _polynomials(window.stop - window.first, degree)
    smooth = values.copy()
    smooth[..., inside] = (values[..., inside] @ basis) @ basis.T
    return smooth


@lru_cache(maxsize=256)
def _polynomials(count: int, degree: int) -> FloatArray:
    """Return an orthonormal basis of the polynomials on ``count`` even points, shape (count, degree + 1)."""
    powers = np.polynomial.chebyshev.chebvander(np.linspace(-1.0, 1.0, count), degree)
    basis, _ = np.linalg.qr(powers)
    return basis
