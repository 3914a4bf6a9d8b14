"""Where a step ends early because something may lock."""

import pytest

from ecu_emulator.plant.integration import approach_fraction, first_root

BAND = 0.1


def test_a_parabola_is_solved_exactly() -> None:
    # 1 - 3 x + x^2 = 0 at x = 0.381966...
    assert first_root(1.0, -3.0, -1.0) == pytest.approx(0.3819660112501051)


def test_a_straight_line_is_solved_exactly() -> None:
    assert first_root(1.0, -4.0, -3.0) == pytest.approx(0.25)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_crossing_stops_just_inside_the_band(sign: float) -> None:
    fraction = approach_fraction(sign * 1.0, sign * -2.0, sign * -1.0, BAND)
    assert 1.0 - 2.0 * fraction == pytest.approx(0.98 * BAND)


@pytest.mark.parametrize(
    ("old", "new"), [(1.0, 0.5), (0.05, -1.0), (1.0, 0.097), (-1.0, -0.3)], ids=["outside", "inside", "edge", "below"]
)
def test_no_crossing_takes_the_whole_step(old: float, new: float) -> None:
    assert approach_fraction(old, new - old, new, BAND) == 1.0
