"""The full-information estimator on one cycle of the plant, without noise and with the paper's."""

from functools import cache

import numpy as np
import pytest

from studies.full_estimator import FullAnalysis, estimate_drive, nominal_vehicle
from studies.reproduce.bound import bounds_percent
from studies.reproduce.drives import Case, PaperDrive, drive
from studies.reproduce.full_route import Found, Job, full_signals, run
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.friction.paper import nominal_driveline
from ecu_emulator.plant import Col

DRIVE_SEED = 7


@cache
def cycle() -> PaperDrive:
    return drive(Case.CASE_2, cycles=1, seed=DRIVE_SEED)


@cache
def analysis() -> FullAnalysis:
    signals = full_signals(cycle(), 1)
    return estimate_drive(signals, nominal_calibration(), nominal_driveline(), nominal_vehicle())


def test_no_clutch_is_taken_for_locked_that_slips() -> None:
    for m in range(2):
        true, found = cycle().is_locked(m + 1), analysis().is_locked[m]
        assert not np.any(found & ~true)
        assert np.count_nonzero(found) > 0.7 * np.count_nonzero(true)


def test_torque_and_slip_are_known_far_better_than_their_sensors() -> None:
    for m, state in enumerate(analysis().clutches):
        rows = np.concatenate([np.arange(one.first, one.first + len(one.torque_nm)) for one in analysis().windows[m]])
        assert len(rows) > 2000
        torque_nm = state.torque_nm[rows] - cycle().rows[rows, Col.CLUTCH1_TORQUE + m]
        assert np.sqrt(np.mean(torque_nm**2)) < 0.1
        slow = rows[np.abs(cycle().slip_rad_s(m + 1)[rows]) < 5.0]
        slip_rad_s = (state.slip_rad_s - cycle().slip_rad_s(m + 1))[slow]
        assert np.sqrt(np.mean(slip_rad_s**2)) < 0.15  # of a sensor with 23 rad/s of noise


@pytest.mark.parametrize("case", list(Case))
def test_without_noise_nothing_is_left_of_the_error(case: Case) -> None:
    for found in run(Job(case, DRIVE_SEED, None, cycles=1)):
        assert abs(found.error) < 0.1, found


def test_with_noise_the_errors_are_those_of_the_bound() -> None:
    found: list[Found] = [one for seed in range(1, 6) for one in run(Job(Case.CASE_2, DRIVE_SEED, seed, cycles=1))]
    bounds = bounds_percent(cycle())
    scores = [one.error / bounds[one.key] for one in found]
    assert len(scores) == 20
    assert np.sqrt(np.mean(np.square(scores))) < 1.5
    assert np.mean([abs(one.error) <= 2.0 * one.std for one in found]) >= 0.8
    assert all(one.is_slope_right for one in found)
