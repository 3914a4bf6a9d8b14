"""Friction from windows made with the model itself."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.full_estimator.fit import FLOOR_RATIO, FullEstimate, fit
from benchmarks.full_estimator.inversion import clutch_torque_nm
from benchmarks.full_estimator.windows import Window
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
