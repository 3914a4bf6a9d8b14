"""The smoother against one dense least squares problem over all its unknowns."""

from typing import NamedTuple

import numpy as np
import pytest

from benchmarks.full_estimator import FullSignals, nominal_vehicle
from benchmarks.full_estimator.motion import Forcing, State, forcing, motion_law
from benchmarks.full_estimator.signals import BoolArray
from benchmarks.full_estimator.smoother import COUPLED_WANDER, LOCK_STD_RAD_S, SIZE, START_STD, rates, smooth
from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.friction.paper import nominal_driveline

PERIOD_S, COUNT = 1e-3, 60
DRIVELINE, VEHICLE = nominal_driveline(), nominal_vehicle()
LAW = motion_law(nominal_calibration().input_side, DRIVELINE, VEHICLE)
SPEED_STD_RAD_S = np.array([3.0, 3.0, 4.0])
UNKNOWN_WANDER = [place for place, wander in enumerate(COUPLED_WANDER) if wander > 0.0]


class Handover(NamedTuple):
    """Readings of a short stretch and what the smoother is told beside them."""

    signals: FullSignals
    forced: Forcing
    is_locked: BoolArray
    about: FloatArray


@pytest.fixture(name="handover")
def make_handover() -> Handover:
    """Noise about a car that accelerates in 3rd gear while clutch 1 is locked in the first half."""
    rng = np.random.default_rng(3)
    times_s = PERIOD_S * np.arange(COUNT)
    diff_rad_s = 30.0 + 2.0 * times_s
    ratio = np.array(DRIVELINE.overall_ratios)[[2, 1]]
    input_rad_s = ratio[:, None] * diff_rad_s + SPEED_STD_RAD_S[1:, None] * rng.standard_normal((2, COUNT))
    signals = FullSignals(
        period_s=PERIOD_S,
        hub_rad_s=ratio[0] * diff_rad_s + SPEED_STD_RAD_S[0] * rng.standard_normal(COUNT),
        input_rad_s=input_rad_s,
        pressure_pa=np.zeros((2, COUNT)),
        flywheel_nm=100.0 + 20.0 * np.sin(40.0 * times_s),
        shaft_nm=np.stack((90.0 + 10.0 * np.sin(30.0 * times_s), 5.0 * np.cos(20.0 * times_s))),
        oil_k=np.full(COUNT, 360.0),
        gears=np.tile(np.array([[3], [2]]), COUNT),
        speed_std_rad_s=SPEED_STD_RAD_S,
        pressure_std_pa=np.full(2, 2.0e4),
    )
    is_locked = np.zeros((2, COUNT), dtype=np.bool_)
    is_locked[0, : COUNT // 2] = True
    about = np.zeros((COUNT, SIZE))
    about[:, State.WHEEL_SPEED], about[:, State.VEHICLE_SPEED] = diff_rad_s, 0.32 * diff_rad_s - 0.1
    return Handover(signals, forcing(signals, DRIVELINE, VEHICLE), is_locked, about)


def transitions(forced: Forcing, about: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return how a state moves on in every period: matrix and offset."""
    drive = np.stack(
        [
            forced.hub_nm,
            forced.hub_share_kg_m2,
            forced.hub_drag_nms_rad,
            forced.diff_nm,
            forced.diff_inertia_kg_m2,
            forced.diff_drag_nms_rad,
        ],
        axis=1,
    )
    steps: list[FloatArray] = []
    offsets: list[FloatArray] = []
    for k in range(COUNT - 1):
        matrix, offset = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
        point = about[k]
        rates(
            0.5 * (drive[k] + drive[k + 1]), point[State.WHEEL_SPEED], point[State.VEHICLE_SPEED], LAW, matrix, offset
        )
        ahead, behind = np.eye(SIZE) - 0.5 * PERIOD_S * matrix, np.eye(SIZE) + 0.5 * PERIOD_S * matrix
        steps.append(np.linalg.solve(ahead, behind).astype(np.float64))
        offsets.append(PERIOD_S * np.linalg.solve(ahead, offset).astype(np.float64))
    return steps, offsets


def dense_solution(handover: Handover, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return all states and the variance of the slip of clutch 1, by least squares over start and every wander."""
    signals, forced, is_locked, about = handover
    steps, offsets = transitions(forced, about)
    width = SIZE + (COUNT - 1) * len(UNKNOWN_WANDER)
    by_unknown = np.zeros((COUNT, SIZE, width))
    fixed = np.zeros((COUNT, SIZE))
    by_unknown[0, :, :SIZE] = np.diag(START_STD)
    fixed[0] = start
    for k in range(COUNT - 1):
        by_unknown[k + 1] = steps[k] @ by_unknown[k]
        fixed[k + 1] = steps[k] @ fixed[k] + offsets[k]
        for j, place in enumerate(UNKNOWN_WANDER):
            column = SIZE + k * len(UNKNOWN_WANDER) + j
            by_unknown[k + 1, place, column] += COUPLED_WANDER[place] * np.sqrt(PERIOD_S)
    rows, values = [np.eye(width)], [np.zeros(width)]
    for k in range(COUNT):
        told = [(np.eye(SIZE)[State.HUB_SPEED], signals.hub_rad_s[k], SPEED_STD_RAD_S[0])]
        for m in range(2):
            turned = forced.ratio[m, k] * np.eye(SIZE)[State.DIFF_SPEED]
            twist_rad_s = forced.twist[m].rate_rad_s[k]
            told.append((turned, signals.input_rad_s[m, k] - twist_rad_s, SPEED_STD_RAD_S[1 + m]))
            if is_locked[m, k]:
                told.append((np.eye(SIZE)[State.HUB_SPEED] - turned, twist_rad_s, LOCK_STD_RAD_S))
        for row, value, std in told:
            rows.append((row @ by_unknown[k] / std)[None])
            values.append(np.array([(value - row @ fixed[k]) / std]))
    matrix, target = np.concatenate(rows), np.concatenate(values)
    covariance = np.linalg.inv(matrix.T @ matrix)
    best = covariance @ (matrix.T @ target)
    states = fixed + by_unknown @ best
    slip = by_unknown[:, State.HUB_SPEED] - forced.ratio[0][:, None] * by_unknown[:, State.DIFF_SPEED]
    return states, np.einsum("kw,wv,kv->k", slip, covariance, slip)


def test_the_smoother_is_the_least_squares_solution(handover: Handover) -> None:
    signals, forced, is_locked, about = handover
    start = np.zeros(SIZE)
    start[State.HUB_SPEED] = np.mean(signals.hub_rad_s[:50])
    start[[State.DIFF_SPEED, State.WHEEL_SPEED]] = np.mean(signals.input_rad_s[0, :50]) / forced.ratio[0, 0]
    start[State.OUTPUT_TWIST] = forced.diff_nm[0] / DRIVELINE.output.stiffness_nm_rad
    start[State.VEHICLE_SPEED] = start[State.WHEEL_SPEED] * DRIVELINE.wheel.radius_m
    states, slip_variance = dense_solution(handover, start)
    found = smooth(signals, forced, LAW, is_locked, about)
    assert found.states == pytest.approx(states, rel=1e-6, abs=1e-6)
    assert found.slip_std_rad_s[0] == pytest.approx(np.sqrt(slip_variance), rel=1e-3)  # rounding at the loose start
