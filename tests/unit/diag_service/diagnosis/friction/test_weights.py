"""Test functions of a slip window, and polynomials in place of what is measured in it."""

import numpy as np
import pytest

from canlog.arrays import FloatArray
from diag_service.diagnosis.alignment import GRID_S
from diag_service.diagnosis.friction.window import SlipWindow, sines, smoothed

GRID = GRID_S * np.arange(-40.0, 460.0)
WINDOW = SlipWindow(first=101, stop=352)  # 0.25 s
INSIDE = slice(WINDOW.first, WINDOW.stop)
COUNT = 12


def outside(values: FloatArray) -> FloatArray:
    """Return what lies before and after the window."""
    return np.concatenate((values[..., : WINDOW.first], values[..., WINDOW.stop :]), axis=-1)


def test_weights_vanish_at_the_ends_and_outside() -> None:
    weights = sines(GRID, WINDOW, COUNT)
    assert weights.value.shape == weights.rate.shape == (COUNT, len(GRID))
    assert not outside(weights.value).any()
    assert not outside(weights.rate).any()
    assert np.abs(weights.value[:, [WINDOW.first, WINDOW.stop - 1]]).max() < 1e-12 * GRID_S


def test_weighting_with_the_rate_replaces_differentiation() -> None:
    """By parts, int psi f' = -int psi' f, but for the error of the trapezoid: no speed is ever differentiated."""
    weights = sines(GRID, WINDOW, COUNT)
    speed, acceleration = np.exp(3.0 * GRID), 3.0 * np.exp(3.0 * GRID)
    assert weights.value @ acceleration == pytest.approx(-(weights.rate @ speed), abs=5e-4)


def test_weights_are_orthogonal() -> None:
    value = sines(GRID, WINDOW, COUNT).value / GRID_S
    length = WINDOW.stop - 1 - WINDOW.first
    assert value @ value.T == pytest.approx(0.5 * length * np.eye(COUNT), abs=1e-9 * length)


@pytest.mark.parametrize("degree", [0, 3, 5])
def test_a_polynomial_is_its_own_fit(degree: int) -> None:
    values = np.polynomial.Polynomial(np.arange(1.0, degree + 2.0))(GRID)
    assert smoothed(values, WINDOW, degree) == pytest.approx(values, rel=1e-12)


def test_smoothing_changes_nothing_outside_and_does_it_once() -> None:
    values = np.random.default_rng(1).normal(size=(3, len(GRID)))
    smooth = smoothed(values, WINDOW, 5)
    assert np.array_equal(outside(smooth), outside(values))
    assert smoothed(smooth, WINDOW, 5) == pytest.approx(smooth, abs=1e-12)
    assert smooth[:, INSIDE].std() < 0.3 * values[:, INSIDE].std()  # six numbers are left of 251


def test_weights_may_be_smoothed_in_place_of_values() -> None:
    values, weights = np.random.default_rng(2).normal(size=len(GRID)), sines(GRID, WINDOW, COUNT).value
    assert smoothed(weights, WINDOW, 5) @ values == pytest.approx(weights @ smoothed(values, WINDOW, 5), abs=1e-14)
