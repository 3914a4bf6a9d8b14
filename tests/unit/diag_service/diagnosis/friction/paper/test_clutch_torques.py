"""Eq. (9) against a numerical least squares solution of eqs. (1) to (3)."""

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.friction.paper import nominal_driveline
from diag_service.diagnosis.friction.paper.differentiate import Rated
from diag_service.diagnosis.friction.paper.method import Speeds, clutch_torques_nm

SIDE = nominal_calibration().input_side
SHAFTS = nominal_driveline().shafts


def random_speeds(rng: np.random.Generator, count: int) -> Speeds:
    hub, first, second = (
        Rated(value=rng.uniform(50.0, 400.0, count), rate=rng.normal(0.0, 300.0, count)) for _ in range(3)
    )
    return Speeds(hub=hub, inputs=(first, second))


def test_the_torques_are_the_least_squares_solution() -> None:
    rng = np.random.default_rng(9)
    count = 30
    speeds, flywheel_nm, shaft_nm = random_speeds(rng, count), rng.normal(0, 90, count), rng.normal(0, 90, (2, count))
    found = clutch_torques_nm(speeds, flywheel_nm, shaft_nm, SIDE, SHAFTS)
    matrix = np.array([[1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    right = [
        flywheel_nm - SIDE.hub_damping_nms_rad * speeds.hub.value - SIDE.hub_inertia_kg_m2 * speeds.hub.rate,
        *(
            shaft.clutch_inertia_kg_m2 * one.rate + carried + shaft.clutch_damping_nms_rad * one.value
            for shaft, one, carried in zip(SHAFTS, speeds.inputs, shaft_nm, strict=True)
        ),
    ]
    expected, *_ = np.linalg.lstsq(matrix, np.array(right), rcond=None)
    assert found == pytest.approx(expected, abs=1e-9)


def test_consistent_equations_give_their_torques_back() -> None:
    rng = np.random.default_rng(10)
    speeds, true_nm = random_speeds(rng, 8), rng.normal(0.0, 120.0, (2, 8))
    hub_nm = (
        SIDE.hub_inertia_kg_m2 * speeds.hub.rate + SIDE.hub_damping_nms_rad * speeds.hub.value + true_nm.sum(axis=0)
    )
    shaft_nm = np.stack(
        [
            torque - shaft.clutch_inertia_kg_m2 * one.rate - shaft.clutch_damping_nms_rad * one.value
            for torque, shaft, one in zip(true_nm, SHAFTS, speeds.inputs, strict=True)
        ]
    )
    assert clutch_torques_nm(speeds, hub_nm, shaft_nm, SIDE, SHAFTS) == pytest.approx(true_nm, abs=1e-9)


def test_slip_is_hub_minus_input() -> None:
    speeds = random_speeds(np.random.default_rng(1), 4)
    assert np.array_equal(speeds.slip_rad_s(2), speeds.hub.value - speeds.inputs[1].value)
