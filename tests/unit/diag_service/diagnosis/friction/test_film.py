"""The film followed by the estimator against a much finer integration of the same law."""

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from clutch_model.pack import (
    contact_pressure_pa,
    equilibrium_film_m,
    film_law,
    viscosity_pa_s,
)
from diag_service.diagnosis.alignment import GRID_S
from diag_service.diagnosis.friction.film import PressureDrive, integrate_films, pack_laws
from tests.support.film_laws import measured_film_rate_m_s

CALIBRATION = nominal_calibration()
OIL_K = 363.15
FINE = 100  # steps per grid step


def engagement_pa(grid_s: FloatArray) -> FloatArray:
    """Empty, filled to just above the touch point, torque ramp, hold, release."""
    return np.interp(grid_s, [0.0, 0.1, 0.15, 0.4, 0.7, 0.9, 0.95, 1.2], [0, 0, 1.6e5, 1.7e5, 4e5, 4e5, 0, 0])


def reference_contact_pa(clutch: int, piston_pa: FloatArray, viscosity: float) -> FloatArray:
    law = film_law(CALIBRATION.clutches[clutch - 1])
    film_m = equilibrium_film_m(0.0, law)
    contact_pa = np.empty_like(piston_pa)
    step_s = GRID_S / FINE
    for k in range(len(piston_pa)):
        contact_pa[k] = contact_pressure_pa(film_m, law)
        if k + 1 < len(piston_pa):
            for j in range(FINE):
                pressure = piston_pa[k] + (j + 0.5) / FINE * (piston_pa[k + 1] - piston_pa[k])
                half = film_m + 0.5 * step_s * measured_film_rate_m_s(film_m, pressure, viscosity, law)
                film_m += step_s * measured_film_rate_m_s(half, pressure, viscosity, law)
                film_m = min(max(film_m, law.min_film_m), law.open_gap_m)
    return contact_pa


@pytest.mark.parametrize("clutch", [1, 2])
def test_contact_pressure_follows_the_film_law(clutch: int) -> None:
    grid_s = np.arange(0.0, 1.2, GRID_S)
    piston_pa = engagement_pa(grid_s)
    drive = PressureDrive(piston_pa=piston_pa, slip_rad_s=np.zeros(len(grid_s)), oil_k=OIL_K, clutch_k=OIL_K)
    track = integrate_films((drive, drive), pack_laws(CALIBRATION))[clutch - 1]
    oil = CALIBRATION.viscosity
    expected = reference_contact_pa(clutch, piston_pa, viscosity_pa_s(OIL_K, oil.a_pa_s, oil.b_k, oil.pole_k))
    assert np.max(expected) > 1e5
    error = np.abs(track.contact_pa - expected) / np.max(expected)
    assert np.max(error) < 0.15  # at the release, where the rate jumps inside a step
    assert np.sort(error)[-3] < 5e-3  # two points on
    assert abs(np.sum(track.contact_pa - expected)) < 1e-3 * np.sum(expected)


def test_a_slipping_pack_heats_by_its_friction_power() -> None:
    grid_s = np.arange(0.0, 1.0, GRID_S)
    drive = PressureDrive(
        piston_pa=np.full(len(grid_s), 3e5), slip_rad_s=np.full(len(grid_s), 50.0), oil_k=OIL_K, clutch_k=OIL_K
    )
    believed = CALIBRATION.clutches[0]
    track = integrate_films((drive, drive), pack_laws(CALIBRATION))[0]
    torque_nm = believed.geometry.faces.contact_factor_m3 * believed.friction.mu_c * track.contact_pa[250]
    heated_k = torque_nm * 50.0 / believed.thermal.heat_capacity_j_k
    assert track.final_clutch_k - OIL_K == pytest.approx(heated_k, rel=0.2)
    assert track.viscous_nm[250] > 0.0
