"""Eq. (17): the coefficient that made a torque is found in it again."""

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from clutch_model.pack import (
    contact_pressure_pa,
    film_law,
    shear_factor_difference,
)
from diag_service.diagnosis.friction.paper.friction_data import (
    NOISELESS_GATES,
    NOISY_GATES,
    FrictionData,
    Gate,
    coulomb_gate,
    fit,
    friction_data,
    static_gate,
)

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


@pytest.mark.parametrize(
    ("slip", "shear", "passes"),
    [
        (0.3, 0.4, True),
        (-0.3, 0.4, True),  # either sign
        (BAND + 0.5, 0.4, True),
        (BAND, 0.4, False),  # locked
        (BAND + 0.51, 0.4, False),  # too fast
        (0.3, 0.6, False),  # partial lubrication
    ],
)
def test_mu_s_comes_from_slow_slip_in_mechanical_contact(slip: float, shear: float, passes: bool) -> None:
    assert static_gate(samples(slip, shear), NOISELESS_GATES, BAND, CURVE.mu_s).rows.tolist() == [passes]


@pytest.mark.parametrize(
    ("slip", "shear", "passes"),
    [
        (20.0, 0.7, True),
        (20.0, 0.6, False),
        (20.0, 0.85, False),
        (1.0, 0.7, False),
        (-20.0, 0.7, False),  # printed without bars: a coasting downshift does not count
    ],
)
def test_mu_c_comes_from_slip_in_partial_lubrication(slip: float, shear: float, passes: bool) -> None:
    assert coulomb_gate(samples(slip, shear), NOISELESS_GATES).rows.tolist() == [passes]


@pytest.mark.parametrize(("rate_pa_s", "passes"), [(2.1e5, True), (2.0e5, False), (-5e5, False)])
def test_with_noise_mu_c_needs_a_stroking_clutch(rate_pa_s: float, passes: bool) -> None:
    data = samples(20.0, 0.7, rate_pa_s=rate_pa_s)
    assert coulomb_gate(data, NOISY_GATES).rows.tolist() == [passes]
    assert coulomb_gate(data, NOISELESS_GATES).rows.tolist() == [True]


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


def test_no_sample_no_number() -> None:
    found = fit(samples(0.0, 1.0), NOISY_GATES, CURVE)
    assert (found.mu_c, found.mu_s) == (None, None)
    assert found.static_counts == {Gate.SHIFTING: 1, Gate.STICK: 0, Gate.MECHANICAL: 0, Gate.NEAR_PRIOR: 0}
