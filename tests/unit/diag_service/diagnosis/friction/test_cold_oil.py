"""What a clutch in cold oil still says of its friction."""

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from clutch_model.units import k_from_degc
from clutch_results.records import Reason, Status
from diag_service.diagnosis.alignment import GRID_S, usable_samples
from diag_service.diagnosis.friction import Estimator, Posterior
from diag_service.diagnosis.friction.balance import Torques
from diag_service.diagnosis.friction.film import FilmTrack, PressureDrive, integrate_films, pack_laws
from tests.support.shifts_of_a_drive import first_shifts, in_oil

CALIBRATION = nominal_calibration()
GRID = np.arange(0.0, 1.0, GRID_S)
SLIP_RAD_S = 100.0


def track_of(piston_pa: list[float], oil_degc: float) -> FilmTrack:
    """Return the film of clutch 1 that slips while its pressure goes from one value to the next [Pa]."""
    pressure = np.interp(GRID, np.linspace(0.0, 1.0, len(piston_pa)), piston_pa)
    oil_k = k_from_degc(oil_degc)
    drive = PressureDrive(piston_pa=pressure, slip_rad_s=np.full(len(GRID), SLIP_RAD_S), oil_k=oil_k, clutch_k=oil_k)
    return integrate_films((drive, drive), pack_laws(CALIBRATION))[0]


def test_friction_is_known_less_by_every_kelvin_away_from_work() -> None:
    drive = PressureDrive(piston_pa=GRID, slip_rad_s=np.full(len(GRID), SLIP_RAD_S), oil_k=350.0, clutch_k=350.0)
    packs_k = (np.full(len(GRID), k_from_degc(degc)) for degc in (100.0, 20.0))
    hot, cool = (track_of([3e5, 3e5], 80.0)._replace(clutch_k=pack_k) for pack_k in packs_k)
    torques = Torques.of((drive, drive), (hot, cool), (hot, cool), pack_laws(CALIBRATION), slice(100, 200))
    for parts_nm, kelvin in zip(torques.parts_nm, (10.0, -70.0), strict=True):
        assert parts_nm[2] == pytest.approx(kelvin * parts_nm[0])


def test_where_the_film_carries_the_torque_nothing_is_said_of_friction() -> None:
    """A shift as it is, but in oil said to be cold: most of its torque would be the film's."""
    state, estimator = Posterior.fresh(CALIBRATION), Estimator(CALIBRATION)
    warm = first_shifts()[0]
    cold = in_oil(warm, -10.0)
    after, estimate = estimator.estimate(cold, usable_samples(cold), state)
    assert (estimate.status, estimate.reasons) == (Status.UNOBSERVED, (Reason.NO_SLIP_WINDOW,))
    assert after.shift_counts == (0, 0)
    assert estimator.estimate(warm, usable_samples(warm), state)[1].status is Status.VALID
