"""Test functions of a slip window, and polynomials in place of what is measured in it."""

import numpy as np
import pytest

from canlog.arrays import FloatArray
from diag_service.diagnosis.alignment import GRID_S, Resampled
from diag_service.diagnosis.friction.drives import Piece, SlipWindow, sines, smoothed

GRID = GRID_S * np.arange(-40.0, 460.0)
WINDOW = SlipWindow.between(101, 352)  # 0.5 s
INSIDE = WINDOW.rows
COUNT = 12


def outside(values: FloatArray) -> FloatArray:
    """Return what lies before and after the window."""
    return np.concatenate((values[..., : INSIDE.start], values[..., INSIDE.stop :]), axis=-1)


def test_weights_are_next_to_nothing_at_the_ends() -> None:
    weights = sines(WINDOW, (COUNT,))
    assert weights.rows == INSIDE
    (value,), (rate,) = weights.value.blocks, weights.rate.blocks
    assert value.shape == rate.shape == (COUNT, INSIDE.stop - INSIDE.start)
    assert np.abs(value[:, [0, -1]]).max() < 0.03 * GRID_S  # what the sine makes of the first half step


def test_sums_are_exact_for_what_is_linear_between_rows() -> None:
    value, rate = (one.blocks[0] for one in (sines(WINDOW, (COUNT,)).value, sines(WINDOW, (COUNT,)).rate))
    bent = np.abs(np.arange(len(value[0])) - 77.0) * GRID_S
    fine_s = np.linspace(0.0, GRID_S * (len(bent) - 1), 500 * (len(bent) - 1) + 1)
    values, turn_1_s = np.interp(fine_s, GRID_S * np.arange(len(bent)), bent), np.pi / fine_s[-1] * np.arange(1, 13)
    by_value = [np.trapezoid(np.sin(one * fine_s) * values, fine_s) for one in turn_1_s]
    by_rate = [np.trapezoid(one * np.cos(one * fine_s) * values, fine_s) for one in turn_1_s]
    assert value @ bent == pytest.approx(np.array(by_value), abs=1e-9)
    assert rate @ bent == pytest.approx(np.array(by_rate), abs=1e-8)


def test_weighting_with_the_rate_replaces_differentiation() -> None:
    """By parts, int psi f' = -int psi' f, as far as f is linear between rows: no speed is ever differentiated."""
    weights = sines(WINDOW, (COUNT,))
    speed = np.exp(3.0 * GRID[INSIDE])
    acceleration = 3.0 * speed
    assert weights.value @ acceleration == pytest.approx(-(weights.rate @ speed), abs=2e-5)


def test_weights_are_orthogonal() -> None:
    value = sines(WINDOW, (COUNT,)).value.blocks[0] / GRID_S
    length = INSIDE.stop - 1 - INSIDE.start
    assert value @ value.T == pytest.approx(0.5 * length * np.eye(COUNT), abs=4e-3 * length)  # but for the hats


@pytest.mark.parametrize("degree", [0, 3, 5])
def test_a_polynomial_is_its_own_fit(degree: int) -> None:
    values = np.polynomial.Polynomial(np.arange(1.0, degree + 2.0))(GRID)
    assert smoothed(values, WINDOW, degree) == pytest.approx(values, rel=1e-12)


def test_smoothing_changes_nothing_outside_and_does_it_once() -> None:
    values = np.random.default_rng(1).normal(size=len(GRID))
    smooth = smoothed(values, WINDOW, 5)
    assert np.array_equal(outside(smooth), outside(values))
    assert smoothed(smooth, WINDOW, 5) == pytest.approx(smooth, abs=1e-12)
    assert smooth[INSIDE].std() < 0.3 * values[INSIDE].std()  # six numbers are left of 251


def test_weights_may_be_fitted_in_place_of_values() -> None:
    window = sines(WINDOW, (COUNT,))
    weights = window.value.blocks[0]
    values = np.random.default_rng(2).normal(size=(weights.shape[1],))
    fits = np.array([window.fitted(row, 5) for row in weights])
    assert fits @ values == pytest.approx(weights @ window.fitted(values, 5), abs=1e-14)


PIECES = SlipWindow.of((Piece(first=101, stop=201), Piece(first=240, stop=352)))


def test_each_piece_has_functions_of_its_own() -> None:
    weights = sines(PIECES, (5, 7))
    assert weights.rows == INSIDE
    assert weights.value.places == (slice(0, 100), slice(139, 251))
    first, second = (sines(SlipWindow.of((one,)), (count,)) for one, count in zip(PIECES.pieces, (5, 7), strict=True))
    values = np.exp(GRID[INSIDE])
    apart = np.concatenate((first.rate.blocks[0] @ values[:100], second.rate.blocks[0] @ values[139:]))
    assert np.array_equal(weights.rate @ values, apart)


def test_functions_are_a_matrix_of_which_most_is_zero() -> None:
    functions = sines(PIECES, (5, 7)).value
    matrix = np.zeros((12, 251))
    matrix[:5, :100], matrix[5:, 139:] = functions.blocks
    factor = np.linspace(-1.0, 2.0, 251)
    both = functions * factor + functions * 3.0
    signal = Resampled(np.arange(-0.05, 0.5, 0.01), np.arange(55.0), GRID)
    assert both @ np.column_stack((factor, factor**2)) == pytest.approx(
        (matrix * (factor + 3.0)) @ np.column_stack((factor, factor**2))
    )
    assert functions.sums() == pytest.approx(matrix.sum(axis=1))
    first = np.searchsorted(signal.times_s, GRID[INSIDE][0], side="right") - 1
    (whole,) = signal.to_samples([matrix], [INSIDE])
    for rows, piece, block in zip(
        (slice(0, 5), slice(5, 12)),
        PIECES.pieces,
        signal.to_samples(functions.blocks, functions.grid_rows),
        strict=True,
    ):
        begin = signal.left[piece.first] - first
        assert block == pytest.approx(whole[rows, begin : begin + block.shape[1]])
        assert np.abs(block).sum() == pytest.approx(np.abs(whole[rows]).sum())
    for piece, means in zip(
        PIECES.pieces, signal.around_samples(GRID[INSIDE], functions.places, functions.grid_rows), strict=True
    ):
        times_s = signal.times_s[signal.left[piece.first] :][: len(means)]
        assert means[1:-2] == pytest.approx(times_s[1:-2], abs=4e-3)  # the ends of a piece cut one short
    for block, piece, fit in zip(functions.blocks, PIECES.pieces, functions.fitted_on_samples(2, signal), strict=True):
        alone = sines(SlipWindow.of((piece,)), (len(block),))
        smooth = np.array([alone.fitted(row, 2) for row in block])
        assert fit == pytest.approx(signal.to_samples([smooth], [slice(piece.first, piece.stop)])[0])


def test_each_piece_has_a_polynomial_of_its_own() -> None:
    values = np.abs(GRID - GRID[220]) ** 2
    assert smoothed(values, PIECES, 2) == pytest.approx(values, rel=1e-9, abs=1e-12)
    fits = sines(PIECES, (5, 7)).fitted(values[INSIDE], 2)
    assert fits[:100] == pytest.approx(values[101:201], rel=1e-9)
    assert not fits[100:139].any()
