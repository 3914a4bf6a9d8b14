"""The public test cycles are those that the regulations print."""

import numpy as np
import pytest

from ecu_emulator.driving.trace import public_trace

PUBLISHED = [  # duration [s], distance [m], highest speed [km/h], time at rest [s]
    pytest.param("wltc", 1800.0, 23_266.0, 131.3, 226, id="wltc"),  # UN GTR 15, Annex 1
    pytest.param("udds", 1369.0, 11_990.0, 91.25, 241, id="udds"),  # US EPA: 7.45 miles, 56.7 mph
    pytest.param("hwfet", 765.0, 16_507.0, 96.4, 5, id="hwfet"),  # US EPA: 10.26 miles, 59.9 mph
    pytest.param("us06", 600.0, 12_888.0, 129.23, 40, id="us06"),  # US EPA: 8.01 miles, 80.3 mph
]


@pytest.mark.parametrize(("name", "duration_s", "distance_m", "top_km_h", "rest_s"), PUBLISHED)
def test_length_distance_and_speed(
    name: str, duration_s: float, distance_m: float, top_km_h: float, rest_s: int
) -> None:
    trace = public_trace(name)
    np.testing.assert_array_equal(trace.t_s, np.arange(duration_s + 1.0))
    assert np.trapezoid(trace.speed_m_s, trace.t_s) == pytest.approx(distance_m, abs=1.0)
    assert trace.speed_m_s.max() * 3.6 == pytest.approx(top_km_h, abs=0.01)
    assert trace.speed_m_s[0] == trace.speed_m_s[-1] == 0.0
    assert np.count_nonzero(trace.speed_m_s == 0.0) == pytest.approx(rest_s, abs=25)
    assert np.all(trace.speed_m_s >= 0.0)
    assert not np.any(trace.grade_ratio)
