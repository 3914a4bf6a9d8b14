"""Perturbations: each changes what it names, by what it states, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.alignment import GRID_S
from diag_service.diagnosis.friction.film_track import PressureDrive
from diag_service.diagnosis.friction.parameters import Considered
from diag_service.diagnosis.friction.perturbations import AREA, COMMON, OFFSET, Perturbation

CALIBRATION = nominal_calibration()
GRID = GRID_S * np.arange(300.0)
RAMP_PA_S = 4.0e5
DRIVE = PressureDrive(
    piston_pa=RAMP_PA_S * GRID, slip_rad_s=np.linspace(100.0, 0.0, len(GRID)), oil_k=350.0, clutch_k=360.0
)


def test_no_perturbation_changes_nothing() -> None:
    none = Perturbation()
    assert none.of_calibration(CALIBRATION) == CALIBRATION
    assert np.array_equal(none.of_drive(DRIVE, GRID).piston_pa, DRIVE.piston_pa)


def test_pressure_and_area_change_the_pressure_that_drives_a_film() -> None:
    assert OFFSET.of_drive(DRIVE, GRID).piston_pa - DRIVE.piston_pa == pytest.approx(OFFSET.pressure_pa)
    area, size = AREA
    assert area.of_drive(DRIVE, GRID).piston_pa == pytest.approx((1.0 + size) * DRIVE.piston_pa)


def test_a_latency_means_that_the_pressure_was_there_earlier() -> None:
    late, latency_s = COMMON[Considered.PRESSURE_LATENCY]
    changed = late.of_drive(DRIVE, GRID).piston_pa - DRIVE.piston_pa
    assert changed[:-1] == pytest.approx(RAMP_PA_S * latency_s)
    assert changed[-1] == 0.0  # beyond the last sample nothing is known


@pytest.mark.parametrize("perturbation", [OFFSET, AREA[0], COMMON[Considered.PRESSURE_LATENCY][0]])
def test_what_changes_a_drive_leaves_slip_temperature_and_calibration(perturbation: Perturbation) -> None:
    changed = perturbation.of_drive(DRIVE, GRID)
    assert np.array_equal(changed.slip_rad_s, DRIVE.slip_rad_s)
    assert (changed.oil_k, changed.clutch_k) == (DRIVE.oil_k, DRIVE.clutch_k)
    assert perturbation.of_calibration(CALIBRATION) == CALIBRATION
    assert perturbation.moves_film


def test_viscosity_is_that_of_the_oil() -> None:
    thicker, size = COMMON[Considered.VISCOSITY]
    changed = thicker.of_calibration(CALIBRATION)
    oil = CALIBRATION.viscosity
    assert changed == replace(CALIBRATION, viscosity=replace(oil, a_pa_s=oil.a_pa_s * (1.0 + size)))
    assert thicker.moves_film


@pytest.mark.parametrize(
    ("parameter", "moves_film"), [(Considered.STRIBECK_SPEED, False), (Considered.CONTACT_STIFFNESS, True)]
)
def test_lining_and_curve_are_those_of_both_clutches(parameter: Considered, moves_film: bool) -> None:
    perturbation, size = COMMON[parameter]
    changed = perturbation.of_calibration(CALIBRATION)
    assert replace(changed, clutches=CALIBRATION.clutches) == CALIBRATION
    for now, before in zip(changed.clutches, CALIBRATION.clutches, strict=True):
        width, stiffness = (
            now.friction.stribeck_speed_rad_s / before.friction.stribeck_speed_rad_s,
            now.film.contact_stiffness_pa / before.film.contact_stiffness_pa,
        )
        expected = (1.0, 1.0 + size) if moves_film else (1.0 + size, 1.0)
        assert (width, stiffness) == pytest.approx(expected)
        assert replace(now, friction=before.friction, film=before.film) == before
    assert perturbation.moves_film is moves_film


@pytest.mark.parametrize("perturbation", [one for one, _ in COMMON.values()])
def test_what_changes_the_calibration_leaves_the_drive(perturbation: Perturbation) -> None:
    changed = replace(perturbation, latency_s=0.0).of_drive(DRIVE, GRID)
    assert np.array_equal(changed.piston_pa, DRIVE.piston_pa)
