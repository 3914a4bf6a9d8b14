"""The driveline model in steps of a period, and the smoother that finds the torques in measured speeds."""

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.friction.paper import nominal_driveline
from diag_service.diagnosis.friction.paper.differentiate import Rated
from diag_service.diagnosis.friction.paper.driveline import State, driveline_model
from diag_service.diagnosis.friction.paper.method import (
    PERIOD_S,
    SPEED_STATES,
    Readings,
    Speeds,
    clutch_torques_nm,
    smoothed_states,
)

SIDE = nominal_calibration().input_side
DRIVELINE = nominal_driveline()
GEARS = (3, 2)
MODEL = driveline_model(GEARS, PERIOD_S, SIDE, DRIVELINE, 3.0)


def handover() -> tuple[FloatArray, FloatArray]:
    """Return states and engine torques of a handover from clutch 2 to clutch 1, made with the model itself."""
    count = 150
    engine_nm = np.full(count, 120.0)
    states = np.zeros((count, len(State)))
    state = np.zeros(len(State))
    ratio1, ratio2 = (DRIVELINE.overall_ratios[gear - 1] for gear in GEARS)
    state[[State.DIFF_SPEED, State.WHEEL_SPEED]] = 30.0
    state[[State.INPUT1_SPEED, State.INPUT2_SPEED]] = 30.0 * ratio1, 30.0 * ratio2
    state[[State.ENGINE_SPEED, State.HUB_SPEED]] = 30.0 * ratio2
    for k in range(count):
        share = min(max((k - 50) / 30.0, 0.0), 1.0)
        state[[State.CLUTCH1_TORQUE, State.CLUTCH2_TORQUE]] = 130.0 * share, 118.0 * (1.0 - share)
        states[k] = state
        state = MODEL.transition @ state + MODEL.engine * engine_nm[k]
    return states, engine_nm


def test_the_smoother_finds_the_torques_of_a_handover() -> None:
    states, engine_nm = handover()
    rng = np.random.default_rng(12)
    stds = np.array([0.2, 0.2, 0.2, 0.2, 0.05])
    torques_nm = states[:, [State.CLUTCH1_TORQUE, State.CLUTCH2_TORQUE]]
    readings = Readings(
        engine_nm=engine_nm + rng.normal(0.0, 3.0, len(engine_nm)),
        speeds_rad_s=states[:, list(SPEED_STATES)] + rng.normal(0.0, stds, (len(states), 5)),
        speed_std_rad_s=stds,
        is_open=torques_nm < 1.0,
    )
    found = smoothed_states(MODEL, readings)
    settled = slice(15, -5)
    flywheel_nm = (found - states)[settled] @ MODEL.flywheel_nm
    shaft_nm = (found - states)[settled] @ MODEL.shaft_nm.T
    assert np.sqrt(np.mean(flywheel_nm**2)) < 2.3  # of 120 N m; the forward filter alone reaches 2.6
    assert np.sqrt(np.mean(shaft_nm**2)) < 4.0  # 4.3


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
