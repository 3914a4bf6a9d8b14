"""Eq. (17): the coefficient that made a torque is found in it again."""

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from clutch_model.pack import contact_pressure_pa, film_law, shear_factor_difference, viscosity_pa_s, viscous_torque_nm
from diag_service.diagnosis.friction.paper.friction_data import (
    FrictionData,
    friction_data,
    pooled,
    viscous_torques_nm,
)

CALIBRATION = nominal_calibration()
CLUTCH = CALIBRATION.clutches[1]
LAW = film_law(CLUTCH)
OIL = CALIBRATION.viscosity
FILM_M = np.array([5e-6, 9e-6, 12e-6, 20e-6])
SLIP_RAD_S = np.array([-40.0, 3.0, 80.0, 5.0])
OIL_K = np.array([350.0, 360.0, 370.0, 380.0])
MU = 0.131


def data() -> FrictionData:
    contact_nm = [
        np.sign(slip) * MU * contact_pressure_pa(film, LAW) * LAW.contact_factor_m3
        for slip, film in zip(SLIP_RAD_S, FILM_M, strict=True)
    ]
    rate, shifting = np.arange(4.0), np.array([True, False, True, True])
    return friction_data(np.array(contact_nm), SLIP_RAD_S, FILM_M, rate, shifting, CLUTCH)


def test_the_viscous_torque_is_that_of_the_law() -> None:
    expected = [
        viscous_torque_nm(slip, film, viscosity_pa_s(oil_k, OIL.a_pa_s, OIL.b_k, OIL.pole_k), LAW)
        for slip, film, oil_k in zip(SLIP_RAD_S, FILM_M, OIL_K, strict=True)
    ]
    assert viscous_torques_nm(SLIP_RAD_S, FILM_M, OIL_K, CLUTCH, OIL) == pytest.approx(expected, rel=1e-12)


def test_the_coefficient_is_found_for_either_sign_of_slip() -> None:
    found = data()
    assert found.mu[:3] == pytest.approx([MU, MU, MU], rel=1e-9)
    assert found.shear_difference[1] == pytest.approx(shear_factor_difference(9e-6 / LAW.roughness_m))
    assert found.static_share[1] == pytest.approx(np.exp(-(3.0 - 0.1) / 6.0))


def test_without_contact_there_is_no_coefficient() -> None:
    assert FILM_M[3] > 2.0 * LAW.roughness_m
    found = data()
    assert found.mu[3] == pytest.approx(MU, rel=1e-6)
    bare = friction_data(
        np.ones(1),
        np.ones(1),
        np.array([100e-6]),
        np.zeros(1),
        np.ones(1, np.bool_),
        CLUTCH,
    )
    assert bare.mu.tolist() == [0.0]


def test_pooling_keeps_every_sample() -> None:
    one = data()
    both = pooled([one, one])
    assert len(both) == 2 * len(one)
    assert np.array_equal(both.pressure_rate_pa_s, np.tile(one.pressure_rate_pa_s, 2))
    assert np.array_equal(both.is_shifting, np.tile(one.is_shifting, 2))
