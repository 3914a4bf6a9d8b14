"""The slip window: one clutch loaded, one way of slipping."""

import numpy as np
import pytest

from diag_service.diagnosis.friction.window import FADE_S, LOADED_PA, MIN_WINDOW_S, SLIP_MIN_RAD_S, find_window

GRID_S = np.arange(0.0, 1.0, 1e-3)
LOADED = np.full(len(GRID_S), 4 * LOADED_PA)
EMPTY = np.full(len(GRID_S), -1e5)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_it_ends_at_the_first_low_slip(direction: float) -> None:
    slip = direction * np.clip(60.0 * (0.6 - GRID_S) / 0.6, 0.0, 60.0)
    window = find_window(GRID_S, slip, LOADED, EMPTY)
    assert window is not None
    assert GRID_S[window.first] == pytest.approx(FADE_S)
    assert abs(slip[window.stop - 1]) > SLIP_MIN_RAD_S >= abs(slip[window.stop])


def test_it_waits_for_the_release_of_the_off_going_clutch() -> None:
    released = np.where(GRID_S < 0.3, 2e5, -0.5e5)
    window = find_window(GRID_S, np.full(len(GRID_S), 40.0), LOADED, released)
    assert window is not None
    assert GRID_S[window.first] == pytest.approx(0.3 + FADE_S)


def test_locked_samples_after_a_crossing_are_never_used() -> None:
    slip = np.where(GRID_S < 0.4, 30.0, 0.0)
    slip[700:720] = 2.0  # noise on a locked clutch
    window = find_window(GRID_S, slip, LOADED, EMPTY)
    assert window is not None
    assert window.stop == 400


@pytest.mark.parametrize(
    ("slip", "on_pa", "off_pa"),
    [
        (np.zeros(len(GRID_S)), LOADED, EMPTY),
        (np.full(len(GRID_S), 40.0), EMPTY, EMPTY),
        (np.full(len(GRID_S), 40.0), LOADED, LOADED),
        (np.where(GRID_S < MIN_WINDOW_S, 40.0, 0.0), LOADED, EMPTY),
    ],
)
def test_no_window_where_friction_cannot_be_seen(slip: np.ndarray, on_pa: np.ndarray, off_pa: np.ndarray) -> None:
    assert find_window(GRID_S, slip, on_pa, off_pa) is None


@pytest.mark.parametrize("count", [0, 1])
def test_a_grid_that_is_no_grid_has_no_window(count: int) -> None:
    assert find_window(GRID_S[:count], EMPTY[:count], EMPTY[:count], EMPTY[:count]) is None
