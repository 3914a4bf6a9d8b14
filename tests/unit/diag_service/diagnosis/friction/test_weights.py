"""Test functions of a slip window, and polynomials in place of what is measured in it."""

import numpy as np
import pytest

from diag_service.diagnosis.alignment import GRID_S
from diag_service.diagnosis.friction.drives import Piece, SlipWindow, sines, smoothed

GRID = GRID_S * np.arange(-40.0, 460.0)
WINDOW = SlipWindow.between(101, 352)  # 0.5 s
INSIDE = WINDOW.rows
COUNT = 12


def test_weighting_with_the_rate_replaces_differentiation() -> None:
    """By parts, int psi f' = -int psi' f, as far as f is linear between rows: no speed is ever differentiated."""
    weights = sines(WINDOW, (COUNT,))
    speed = np.exp(3.0 * GRID[INSIDE])
    acceleration = 3.0 * speed
    assert weights.value @ acceleration == pytest.approx(-(weights.rate @ speed), abs=2e-5)


@pytest.mark.parametrize("degree", [0, 3, 5])
def test_a_polynomial_is_its_own_fit(degree: int) -> None:
    values = np.polynomial.Polynomial(np.arange(1.0, degree + 2.0))(GRID)
    assert smoothed(values, WINDOW, degree) == pytest.approx(values, rel=1e-12)


PIECES = SlipWindow.of((Piece(first=101, stop=201), Piece(first=240, stop=352)))


def test_each_piece_has_functions_of_its_own() -> None:
    weights = sines(PIECES, (5, 7))
    assert weights.rows == INSIDE
    assert weights.value.places == (slice(0, 100), slice(139, 251))
    first, second = (sines(SlipWindow.of((one,)), (count,)) for one, count in zip(PIECES.pieces, (5, 7), strict=True))
    values = np.exp(GRID[INSIDE])
    apart = np.concatenate((first.rate.blocks[0] @ values[:100], second.rate.blocks[0] @ values[139:]))
    assert np.array_equal(weights.rate @ values, apart)
