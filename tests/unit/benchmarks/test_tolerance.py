"""The tolerance of the WLTP, on traces made up for it."""

import numpy as np
import pytest

from benchmarks.tolerance import is_within_tolerance, share_within_tolerance, speed_limits_m_s
from canlog.arrays import FloatArray
from ecu_emulator.driving.trace import SpeedTrace

KM_H = 1.0 / 3.6


def trace(t_s: list[float], speed_m_s: list[float]) -> SpeedTrace:
    return SpeedTrace(name="made up", t_s=np.array(t_s), speed_m_s=np.array(speed_m_s), grade_ratio=np.zeros(len(t_s)))


CONSTANT = trace([0.0, 100.0], [10.0, 10.0])
RAMP = trace([0.0, 10.0], [0.0, 20.0])  # 2 m/s^2


def driven(until_s: float) -> FloatArray:
    return np.arange(0.0, until_s + 5e-4, 1e-3)


@pytest.mark.parametrize(("error_km_h", "is_within"), [
    (0.0, True), (1.99, True), (-1.99, True), (2.0, True), (-2.0, True), (2.01, False), (-2.01, False),
])  # fmt: skip
def test_two_km_h_of_a_steady_speed(error_km_h: float, is_within: bool) -> None:
    t_s = driven(50.0)
    share = share_within_tolerance(CONSTANT, t_s, np.full(len(t_s), 10.0 + error_km_h * KM_H))
    assert share == float(is_within)


@pytest.mark.parametrize(
    ("late_s", "is_within"), [(0.0, True), (0.99, True), (-0.99, True), (1.27, True), (1.3, False)]
)
def test_one_second_of_a_rising_speed(late_s: float, is_within: bool) -> None:
    """2 m/s^2: 1 s late is on the second, and 2 km/h more are another 0.278 s."""
    t_s = np.array([4.0, 5.0, 6.0])
    assert is_within_tolerance(RAMP, t_s, 2.0 * (t_s - late_s)).tolist() == [is_within] * 3


def test_limits_are_those_of_a_dense_search() -> None:
    rng = np.random.default_rng(5)
    points_s = np.concatenate(([0.0], np.cumsum(rng.uniform(0.1, 3.0, 59))))
    wild = trace(points_s.tolist(), rng.uniform(0.0, 30.0, 60).tolist())
    t_s = rng.uniform(-1.0, points_s[-1] + 2.0, 300)
    window_s = np.unique(np.concatenate((np.linspace(-1.0, 1.0, 4001), [0.0])))
    speed_m_s = np.interp(t_s[:, None] + window_s, wild.t_s, wild.speed_m_s)
    low_m_s, high_m_s = speed_limits_m_s(wild, t_s)
    np.testing.assert_allclose(low_m_s + 2.0 * KM_H, speed_m_s.min(axis=1), atol=0.11)
    np.testing.assert_allclose(high_m_s - 2.0 * KM_H, speed_m_s.max(axis=1), atol=0.11)
    assert np.all(low_m_s + 2.0 * KM_H <= speed_m_s.min(axis=1) + 1e-12)
    assert np.all(high_m_s - 2.0 * KM_H >= speed_m_s.max(axis=1) - 1e-12)
