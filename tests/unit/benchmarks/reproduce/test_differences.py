"""Central differences against polynomials, the matched filter, and the table of films that clutches passed."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from benchmarks.reproduce.differences import central_difference, matched_filter
from benchmarks.reproduce.drives import trajectory_table
from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from clutch_model.pack import film_law
from diag_service.diagnosis.friction.paper.differentiate import SteadyKalman
from diag_service.diagnosis.friction.paper.friction_data import static_table

PERIOD_S = 1e-3
CLUTCHES = nominal_calibration().clutches


@pytest.mark.parametrize("count", [5, 6, 50])
def test_central_differences_are_exact_for_quartics(count: int) -> None:
    quartic = Polynomial([2.0, -3.0, 0.5, 4.0, -1.5])
    t_s = np.arange(count) * 0.1
    found = central_difference(quartic(t_s), 0.1)
    assert found.rate == pytest.approx(quartic.deriv()(t_s), abs=1e-9)
    assert np.array_equal(found.value, quartic(t_s))


def test_central_differences_are_of_fourth_order() -> None:
    def worst(period_s: float) -> float:
        t_s = np.arange(0.0, 2.0, period_s)
        return float(np.max(np.abs(central_difference(np.sin(5.0 * t_s), period_s).rate - 5.0 * np.cos(5.0 * t_s))))

    assert worst(0.02) / worst(0.01) == pytest.approx(16.0, rel=0.15)


def test_four_samples_have_no_fourth_order_derivative() -> None:
    with pytest.raises(ValueError, match="got 4"):
        central_difference(np.zeros(4), PERIOD_S)


def noisy_swing() -> tuple[FloatArray, FloatArray]:
    t_s = np.arange(0.0, 5.0, PERIOD_S)
    noise = np.random.default_rng(4).normal(0.0, 5.0, len(t_s))
    return 30.0 * np.sin(4.0 * t_s) + noise, 120.0 * np.cos(4.0 * t_s)


def test_a_matched_filter_comes_nearer_than_slower_and_faster_ones() -> None:
    samples, ideal = noisy_swing()
    best = matched_filter(samples, ideal, PERIOD_S)

    def miss(kalman: SteadyKalman) -> float:
        return float(np.mean((kalman(samples, PERIOD_S).rate - ideal) ** 2))

    for factor in (0.5, 2.0):
        other = SteadyKalman(value_gain=best.value_gain * factor, rate_gain_1_s=best.rate_gain_1_s * factor**2)
        assert miss(best) < miss(other)
    assert miss(best) < 0.2 * float(np.mean(ideal**2))


def test_a_trajectory_table_holds_medians_where_it_was_seen_and_equilibria_elsewhere() -> None:
    law = film_law(CLUTCHES[0])
    rng = np.random.default_rng(6)
    pressure_pa = rng.uniform(4.0e5, 4.1e5, 101)
    film_m = rng.uniform(11e-6, 13e-6, 101)
    film_m[:20] = 90e-6  # outliers do not move a median far
    table, equilibria = trajectory_table(pressure_pa, film_m, law), static_table(law)
    assert table.film_at(np.array([4.05e5]))[0] == pytest.approx(np.median(film_m))
    for elsewhere_pa in (3.05e5, 6.05e5):
        where = np.array([elsewhere_pa])
        assert table.film_at(where) == pytest.approx(equilibria.film_at(where))
