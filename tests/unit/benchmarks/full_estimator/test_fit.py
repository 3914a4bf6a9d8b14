"""Friction from windows made with the model itself."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.full_estimator.fit import FLOOR_RATIO, FullEstimate, fit
from benchmarks.full_estimator.inversion import clutch_torque_nm
from benchmarks.full_estimator.windows import WINDOW_MIN_COUNT, Window, stretches
from clutch_model.calibration import nominal_calibration
from clutch_model.pack import equilibrium_film_m, film_law, friction_law

BELIEVED = nominal_calibration().clutches[0]
LAW, BELIEVED_FRICTION = film_law(BELIEVED), friction_law(BELIEVED.friction)
TRUE = BELIEVED_FRICTION._replace(mu_c=0.125, mu_s=0.132)
COUNT, VISCOSITY, STD_PA = 600, 6.42e-3, 2.0e4


def window(seed: int, slip_error_rad_s: float = 0.0, std_pa: float = STD_PA) -> Window:
    """Return an engagement of a clutch with the true friction, its slip known this badly."""
    share = np.arange(COUNT) / COUNT
    applied_pa = 1.0e5 + 2.0e5 * np.sin(2.0 * share + 0.1 * seed) ** 2
    speed_rad_s = 90.0 * (1.0 - share) ** 2 + 0.4
    films_m = np.array([equilibrium_film_m(float(one), LAW) for one in applied_pa])
    torque_nm = np.array(
        [
            clutch_torque_nm(float(film), float(speed), VISCOSITY, TRUE, LAW)
            for film, speed in zip(films_m, speed_rad_s, strict=True)
        ]
    )
    exact = Window(
        first=1000 * seed,
        period_s=1e-3,
        torque_nm=torque_nm,
        speed_rad_s=speed_rad_s,
        slip_std_rad_s=0.05,
        viscosity=np.full(COUNT, VISCOSITY),
        reading_pa=np.zeros(COUNT),
        reading_std_pa=STD_PA,
    )
    noise_pa = std_pa * np.random.default_rng(seed).standard_normal(COUNT)
    return replace(exact, reading_pa=exact.piston_pa(TRUE, LAW) + noise_pa, speed_rad_s=speed_rad_s + slip_error_rad_s)


def fitted(windows: list[Window]) -> FullEstimate:
    estimate = fit(windows, BELIEVED)
    assert estimate is not None
    return estimate


def test_without_noise_the_friction_comes_back() -> None:
    estimate = fitted([window(seed, std_pa=0.0) for seed in range(3)])
    assert (estimate.mu_c, estimate.mu_s) == pytest.approx((TRUE.mu_c, TRUE.mu_s), rel=1e-5)
    assert estimate.window_count == 3


def test_the_stated_deviations_are_those_of_the_errors() -> None:
    estimates = [fitted([window(10 * run + k) for k in range(3)]) for run in range(20)]
    scores = [
        [(one.mu_c - TRUE.mu_c) / one.random_std_mu_c, (one.mu_s - TRUE.mu_s) / one.random_std_mu_s]
        for one in estimates
    ]
    assert np.sqrt(np.mean(np.square(scores), axis=0)) == pytest.approx(1.0, abs=0.4)
    assert np.mean([one.chi_square_ratio for one in estimates]) == pytest.approx(1.0, abs=0.03)
    assert all(one.std_mu_c >= FLOOR_RATIO * one.mu_c for one in estimates)


def test_a_slip_that_is_off_costs_little() -> None:
    plain = fitted([window(seed, std_pa=0.0) for seed in range(3)])
    off = fitted([window(seed, slip_error_rad_s=0.05, std_pa=0.0) for seed in range(3)])
    assert off.mu_s == pytest.approx(plain.mu_s, abs=0.5 * plain.random_std_mu_s)


@pytest.mark.parametrize("fault_pa", [-2.0e4, 3.0e4, 1.0e5])
def test_a_window_that_the_model_does_not_describe_is_refused(fault_pa: float) -> None:
    sound = [window(seed) for seed in range(6)]
    broken = replace(sound[2], reading_pa=sound[2].reading_pa + fault_pa * np.linspace(0.0, 2.0, COUNT) ** 2)
    estimate = fitted([*sound[:2], broken, *sound[3:]])
    assert (estimate.rejected_count, estimate.window_count) == (1, 5)
    assert abs(estimate.mu_c - TRUE.mu_c) < 4.0 * estimate.random_std_mu_c


def test_nothing_comes_of_nothing() -> None:
    assert fit([], BELIEVED) is None


def test_stretches_are_trimmed_and_long_enough() -> None:
    wanted = np.zeros(200, dtype=np.bool_)
    wanted[10:60] = True
    wanted[100 : 100 + WINDOW_MIN_COUNT + 3] = True  # a sample short after trimming
    assert stretches(wanted, 2) == [slice(12, 58)]
    assert stretches(np.ones(30, dtype=np.bool_), 0) == [slice(0, 30)]
