"""A driveline on a slipping clutch: friction that falls with the slip feeds its swing, dampers take from it."""

import pytest

from benchmarks.judder import FLUIDS, growth_per_s


@pytest.mark.parametrize("slip_rad_s", [0.5, 1.0, 2.0])
def test_aged_fluid_feeds_the_swing_from_a_load_on(slip_rad_s: float) -> None:
    growths = [growth_per_s(load_nm, slip_rad_s, FLUIDS["aged"])[0] for load_nm in (20.0, 40.0, 60.0, 80.0)]
    assert growths == sorted(growths)
    assert growths[0] < -5.0
    assert growths[-1] > 10.0


@pytest.mark.parametrize("load_nm", [20.0, 40.0, 120.0])
def test_new_fluid_damps_it_the_more_the_greater_the_load(load_nm: float) -> None:
    growth, _ = growth_per_s(load_nm, 4.0, FLUIDS["new"])
    assert not growth > -20.0  # not a number: too damped to swing


def test_the_swing_is_that_of_the_gears_on_the_side_shafts() -> None:
    _, frequency_hz = growth_per_s(30.0, 1.0, FLUIDS["aged"])
    assert 7.0 < frequency_hz < 10.0  # 12 kNm/rad on 3.4 kg m^2: 9.5 Hz, the second shaft turns along
