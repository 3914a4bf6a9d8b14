"""The study of what cars without pressures tell: one vehicle goes the whole way, and its bars can be missed."""

import numpy as np
import pytest

from studies.tiers import BROADCASTS, MEASURES, Compared, TierCase, compared, table_of

OF_TORQUES = {"torque_capacity_ratio", "slip_energy_j"}
OF_RATIOS = {"ratio_before", "ratio_after"}


def test_a_vehicle_as_four_cars_tell_of_it() -> None:
    found = compared(TierCase(seed=5, trace="udds", duration_s=60.0))
    measures = {car.name: {one.measure for one in found if one.broadcast == car.name} for car in BROADCASTS}
    fast, seldom, alone, slow = (measures[car.name] for car in BROADCASTS)
    assert fast == seldom == MEASURES.keys() - OF_RATIOS  # such buses tell no output speed
    assert alone == MEASURES.keys() - OF_TORQUES
    assert slow == alone - {"judder_rad_s"}
    errors, stds = np.array([(one.value - one.true, one.std) for one in found]).T
    assert np.mean(np.abs(errors) < 2.0 * stds) > 0.9


def told(error: float, std: float, count: int = 100) -> list[Compared]:
    """Return one measure whose errors are normal with one deviation, and which states another."""
    errors = np.random.default_rng(0).normal(0.0, error, count)
    return [
        Compared(broadcast="a car", measure="jerk_m_s3", value=5.0 + one, std=std, true=5.0) for one in errors.tolist()
    ]


@pytest.mark.parametrize(("std", "is_met"), [(1.0, True), (0.5, False), (2.0, False)])
def test_bars_are_missed_by_too_small_and_by_too_large_deviations(std: float, is_met: bool) -> None:
    assert table_of("a car", told(1.0, std))[1] is is_met
