"""The public test cycles are those that the regulations print."""

from importlib.resources import files

import numpy as np
import pytest

from ecu_emulator.driving.trace import PUBLIC_TRACES, public_trace
from ecu_emulator.errors import ConfigError

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


def test_wltc_has_the_checksum_of_the_regulation() -> None:
    assert np.sum(public_trace("wltc").speed_m_s) * 3.6 == pytest.approx(83_758.6, abs=0.05)


@pytest.mark.parametrize(("begin_s", "end_s", "distance_m"), [
    (0, 589, 3095.0), (589, 1022, 4756.0), (1022, 1477, 7162.0), (1477, 1800, 8254.0),
])  # fmt: skip
def test_wltc_phases_have_their_published_distances(begin_s: int, end_s: int, distance_m: float) -> None:
    trace = public_trace("wltc")
    phase = slice(begin_s, end_s + 1)
    assert np.trapezoid(trace.speed_m_s[phase], trace.t_s[phase]) == pytest.approx(distance_m, abs=1.0)


@pytest.mark.parametrize("name", PUBLIC_TRACES)
def test_a_table_names_its_source_and_its_units(name: str) -> None:
    lines = files("ecu_emulator").joinpath(f"driving/traces/{name}.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# ")
    assert "UN Global Technical Regulation" in lines[0] or "US 40 CFR" in lines[0]
    assert lines[1] == "t_s,speed_km_h"


def test_an_unknown_name_is_told_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="no speed trace 'nedc': use one of wltc, udds, hwfet, us06"):
        public_trace("nedc")
