"""Test functions of a window, and polynomials in place of what is measured in it."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.alignment.sampling import GRID_S
from diag_service.diagnosis.friction.window import SlipWindow

SLIP_DEGREE = 5  # a shift controller's slip profile: smooth start, smooth end


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """Sines that vanish at both ends of the window, and their derivatives, times the grid step."""

    value: FloatArray  # (k, len(grid))
    rate: FloatArray  # (k, len(grid))


def sines(grid_s: FloatArray, window: SlipWindow, count: int) -> Weights:
    """Return ``count`` sine test functions on the window; zero outside."""
    value = np.zeros((count, len(grid_s)))
    rate = np.zeros_like(value)
    inside = slice(window.first, window.stop)
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
    inside = slice(window.first, window.stop)
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
