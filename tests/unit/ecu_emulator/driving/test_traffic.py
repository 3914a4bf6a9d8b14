"""Seeded traffic: what is drawn stays within what drivers do and cars can follow."""

from functools import cache

import numpy as np
import pytest

from ecu_emulator.driving.traffic import (
    CITY,
    MAX_ACCELERATION_M_S2,
    MAX_DECELERATION_M_S2,
    MAX_POWER_W_KG,
    MIXED,
    MOTORWAY,
    PERIOD_S,
    SpeedTrace,
    Traffic,
    traffic_trace,
)

SEEDS = range(15)
DURATION_S = 900.0


@cache
def trip(traffic: Traffic, seed: int, grade_ratio: float = 0.0) -> SpeedTrace:
    return traffic_trace(traffic, DURATION_S, np.random.default_rng(seed), grade_ratio=grade_ratio)


def stops(trace: SpeedTrace) -> int:
    return int(np.count_nonzero(np.diff((trace.speed_m_s == 0.0).astype(int)) == 1))


@pytest.mark.parametrize("traffic", [CITY, MIXED, MOTORWAY], ids=lambda traffic: traffic.name)
def test_every_trip_is_one_that_can_be_driven(traffic: Traffic) -> None:
    for trace in (trip(traffic, seed) for seed in SEEDS):
        acceleration_m_s2 = np.diff(trace.speed_m_s) / PERIOD_S
        assert acceleration_m_s2.max() <= MAX_ACCELERATION_M_S2 + 1e-9
        assert acceleration_m_s2.min() >= -MAX_DECELERATION_M_S2 - 1e-9
        assert np.max(acceleration_m_s2 * trace.speed_m_s[:-1]) <= MAX_POWER_W_KG + 0.1
        assert trace.speed_m_s.min() == trace.speed_m_s[0] == trace.speed_m_s[-1] == 0.0
        assert trace.speed_m_s.max() <= traffic.cruise_m_s[1] + 1e-9
        assert trace.duration_s >= DURATION_S
        assert trace.name == traffic.name


def test_city_traffic_stops_creeps_and_differs() -> None:
    traces = [trip(CITY, seed) for seed in SEEDS]
    stops_per_1000_s = [1000.0 * stops(trace) / trace.duration_s for trace in traces]
    assert 10.0 < np.mean(stops_per_1000_s) < 35.0
    slow = [np.mean((trace.speed_m_s > 0.0) & (trace.speed_m_s < 3.0)) for trace in traces]
    assert np.mean(slow) > 0.05  # queues
    accelerations = np.concatenate([np.diff(trace.speed_m_s) / PERIOD_S for trace in traces])
    starts = accelerations[accelerations > 0.3]
    assert np.percentile(starts, 90) > 2.0 * np.percentile(starts, 10)  # gentle and eager starts
    assert len({trace.duration_s for trace in traces}) > len(SEEDS) // 2
