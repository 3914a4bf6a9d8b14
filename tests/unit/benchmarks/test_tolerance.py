"""The tolerance of the WLTP, on traces made up for it."""

import numpy as np
import pytest

from benchmarks.tolerance import is_within_tolerance, share_within_tolerance, speed_limits_m_s
from canlog.arrays import FloatArray
from clutch_model.errors import DomainError
from ecu_emulator.driving.trace import SpeedTrace

KM_H = 1.0 / 3.6


def trace(t_s: list[float], speed_m_s: list[float]) -> SpeedTrace:
    return SpeedTrace(name="made up", t_s=np.array(t_s), speed_m_s=np.array(speed_m_s), grade_ratio=np.zeros(len(t_s)))


CONSTANT = trace([0.0, 100.0], [10.0, 10.0])
RAMP = trace([0.0, 10.0], [0.0, 20.0])  # 2 m/s^2
PEAK = trace([0.0, 10.0, 20.0], [0.0, 20.0, 0.0])
STEP = trace([0.0, 9.0, 10.0, 19.0], [0.0, 0.0, 10.0, 10.0])


def driven(until_s: float) -> FloatArray:
    return np.arange(0.0, until_s + 5e-4, 1e-3)


def test_the_trace_itself_is_within() -> None:
    for one in (CONSTANT, RAMP, PEAK, STEP):
        t_s = driven(one.t_s[-1])
        assert share_within_tolerance(one, t_s, np.interp(t_s, one.t_s, one.speed_m_s)) == 1.0


def test_a_whole_drive_within_is_exactly_one_wherever_its_times_lie_in_memory() -> None:
    for length in range(2, 2000):
        t_s = np.linspace(0.0, 1e-3 * (length - 1), length)
        assert share_within_tolerance(CONSTANT, t_s, np.full(length, 10.0)) == 1.0


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


def test_a_peak_counts_for_the_second_before_and_after_it() -> None:
    low_m_s, high_m_s = speed_limits_m_s(PEAK, np.array([8.5, 9.5, 10.0, 10.9, 11.5]))
    np.testing.assert_allclose(high_m_s - 2.0 * KM_H, [19.0, 20.0, 20.0, 20.0, 19.0])
    np.testing.assert_allclose(low_m_s + 2.0 * KM_H, [15.0, 17.0, 18.0, 16.2, 15.0])


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


def test_the_share_is_one_of_time_not_of_instants() -> None:
    t_s = np.concatenate((np.arange(0.0, 10.0, 0.01), [10.0, 40.0]))  # dense while right, then 30 s of one wrong value
    speed_m_s = np.where(t_s < 10.0, 10.0, 11.0)
    assert share_within_tolerance(CONSTANT, t_s, speed_m_s) == pytest.approx(0.25)


def test_a_drive_that_goes_on_after_the_trace_is_held_against_its_end() -> None:
    t_s = np.arange(0.0, 120.0, 0.5)
    assert share_within_tolerance(CONSTANT, t_s, np.full(len(t_s), 10.0)) == 1.0


@pytest.mark.parametrize(("t_s", "speed_m_s"), [
    ([0.0], [10.0]), ([], []), ([0.0, 1.0], [10.0]), ([0.0, 0.0], [10.0, 10.0]), ([1.0, 0.0], [10.0, 10.0]),
    ([0.0, 1.0], [10.0, np.nan]),
])  # fmt: skip
def test_what_is_no_drive_is_refused(t_s: list[float], speed_m_s: list[float]) -> None:
    with pytest.raises(DomainError):
        share_within_tolerance(CONSTANT, np.array(t_s), np.array(speed_m_s))
