"""Eq. (17): the coefficient that made a torque is found in it again."""

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from clutch_model.pack import contact_pressure_pa, film_law, shear_factor_difference
from diag_service.diagnosis.friction.paper.method import NOISELESS_GATES, NOISY_GATES, FrictionData, fit, friction_data

CALIBRATION = nominal_calibration()
CLUTCH = CALIBRATION.clutches[1]
LAW = film_law(CLUTCH)
FILM_M = np.array([5e-6, 9e-6, 12e-6, 20e-6])
SLIP_RAD_S = np.array([-40.0, 3.0, 80.0, 5.0])
MU = 0.131


def data() -> FrictionData:
    contact_nm = [
        np.sign(slip) * MU * contact_pressure_pa(film, LAW) * LAW.contact_factor_m3
        for slip, film in zip(SLIP_RAD_S, FILM_M, strict=True)
    ]
    rate, shifting = np.arange(4.0), np.array([True, False, True, True])
    return friction_data(np.array(contact_nm), SLIP_RAD_S, FILM_M, rate, shifting, CLUTCH)


def test_the_coefficient_is_found_for_either_sign_of_slip() -> None:
    found = data()
    assert found.mu[:3] == pytest.approx([MU, MU, MU], rel=1e-9)
    assert found.shear_difference[1] == pytest.approx(shear_factor_difference(9e-6 / LAW.roughness_m))
    assert found.static_share[1] == pytest.approx(np.exp(-(3.0 - 0.1) / 6.0))


CURVE = nominal_calibration().clutches[0].friction
BAND = CURVE.lock_band_rad_s


def samples(
    slip_rad_s: float, shear: float, mu: float = 0.12, rate_pa_s: float = 5e5, *, in_shift: bool = True
) -> FrictionData:
    slip = np.array([slip_rad_s])
    return FrictionData(
        mu=np.array([mu]),
        slip_rad_s=slip,
        shear_difference=np.array([shear]),
        pressure_rate_pa_s=np.array([rate_pa_s]),
        static_share=np.exp(-np.maximum(np.abs(slip) - BAND, 0.0) / CURVE.stribeck_speed_rad_s),
        is_shifting=np.array([in_shift]),
    )


def drive(mu_c: float, mu_s: float, noise: float = 0.0) -> FrictionData:
    """Return slow slip in contact, then fast slip in partial lubrication, then locked samples that mean nothing."""
    slip = np.concatenate((np.full(40, 0.1001), np.linspace(2.0, 60.0, 400), np.zeros(100)))
    share = np.exp(-np.maximum(np.abs(slip) - BAND, 0.0) / CURVE.stribeck_speed_rad_s)
    mu = mu_c + (mu_s - mu_c) * share + noise * np.random.default_rng(8).normal(size=len(slip))
    mu[-100:] = 0.01
    return FrictionData(
        mu=mu,
        slip_rad_s=slip,
        shear_difference=np.concatenate((np.full(40, 0.3), np.full(400, 0.7), np.full(100, 0.3))),
        pressure_rate_pa_s=np.full(len(slip), 1e6),
        static_share=share,
        is_shifting=np.ones(len(slip), np.bool_),
    )


@pytest.mark.parametrize("gates", [NOISELESS_GATES, NOISY_GATES])
@pytest.mark.parametrize(("mu_c", "mu_s"), [(0.14, 0.119), (0.119, 0.137)])
def test_clean_samples_give_their_curve_back(gates: object, mu_c: float, mu_s: float) -> None:
    found = fit(drive(mu_c, mu_s), NOISELESS_GATES if gates is NOISELESS_GATES else NOISY_GATES, CURVE)
    assert found.mu_c == pytest.approx(mu_c, rel=1e-6)
    assert found.mu_s == pytest.approx(mu_s, rel=1e-4)
    assert (found.static_count, found.coulomb_count) == (40, 400)
