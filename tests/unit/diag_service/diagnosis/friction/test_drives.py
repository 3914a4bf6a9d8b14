"""The slip window: every clutch that carries torque slips one way."""

import numpy as np
import pytest

from canlog.arrays import BoolArray, FloatArray
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.alignment import GRID_S as STEP_S
from diag_service.diagnosis.alignment import AlignedSignals, Resampled
from diag_service.diagnosis.friction.drives import (
    FADE_S,
    LOADED_PA,
    MIN_PIECE_S,
    RELEASED_PA,
    SLIP_MIN_RAD_S,
    RowRange,
    SlipWindow,
    find_window,
    loaded_clutch,
    measured_drives,
    planned_drives,
)
from diag_service.diagnosis.friction.film import integrate_films, pack_laws
from diag_service.diagnosis.friction.posterior import Posterior

GRID_S = 1e-3 * np.arange(1000.0)
LOADED = np.full(len(GRID_S), 4 * LOADED_PA)
EMPTY = np.full(len(GRID_S), -1e5)
STILL = np.zeros(len(GRID_S))
FAST = np.full(len(GRID_S), 40.0)
SEEN = np.ones(len(GRID_S), np.bool_)
FADE = round(FADE_S / 1e-3)


def found(
    first: tuple[FloatArray, FloatArray], second: tuple[FloatArray, FloatArray], is_seen: BoolArray = SEEN
) -> SlipWindow | None:
    """Return the window of two clutches, each given by its slip and its pressure above the touch point."""
    return find_window(GRID_S, np.array([first[0], second[0]]), np.array([first[1], second[1]]), is_seen)


def pieces_of(window: SlipWindow | None) -> list[tuple[int, int]]:
    assert window is not None
    return [(piece.first, piece.stop) for piece in window.pieces]


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_it_ends_at_the_first_low_slip(direction: float) -> None:
    slip = direction * np.clip(60.0 * (0.6 - GRID_S) / 0.6, 0.0, 60.0)
    for window in (found((slip, LOADED), (FAST, EMPTY)), found((STILL, EMPTY), (slip, LOADED))):
        ((first, stop),) = pieces_of(window)
        assert first == FADE
        assert abs(slip[stop - 1]) > SLIP_MIN_RAD_S >= abs(slip[stop])


def test_the_off_going_clutch_speaks_while_the_on_coming_one_fills() -> None:
    """A kickdown: the engine runs up against the clutch that lets go; what comes on is empty until then."""
    filling = np.where(GRID_S < 0.6, -0.5e5, 2e5)
    assert pieces_of(found((FAST, LOADED), (STILL, filling))) == [(FADE, 600)]


BETWEEN = np.full(len(GRID_S), 0.5 * (RELEASED_PA + LOADED_PA))


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ((STILL, LOADED), (FAST, EMPTY)),
        ((FAST, EMPTY), (FAST, EMPTY)),
        ((FAST, BETWEEN), (STILL, EMPTY)),
        ((FAST, LOADED), (STILL, BETWEEN)),
        ((FAST, LOADED), (STILL, LOADED)),
        ((np.where(GRID_S < MIN_PIECE_S, 40.0, 0.0), LOADED), (STILL, EMPTY)),
    ],
)
def test_no_window_where_friction_cannot_be_seen(
    first: tuple[FloatArray, FloatArray], second: tuple[FloatArray, FloatArray]
) -> None:
    assert found(first, second) is None


def test_a_rest_before_the_event_is_a_piece_of_its_own() -> None:
    """At a stop both clutches are open; then one launches the car."""
    grid_s = 1e-3 * np.arange(-1800.0, 1200.0)
    slip = np.full((2, len(grid_s)), 80.0)
    launching = np.where(grid_s < 0.1, -1e5, 2e5)
    window = find_window(
        grid_s, slip, np.array([launching, np.full(len(grid_s), -1e5)]), np.ones(len(grid_s), np.bool_)
    )
    assert window is not None
    rest, *others = window.pieces
    assert (rest.is_rest, rest.first, rest.stop) == (True, 0, 1800)
    assert not any(piece.is_rest for piece in others)
    assert window.slipping == tuple(others)
    assert window.slip_rows == slice(1900 + FADE, 3000)
    assert loaded_clutch(window, slip, np.array([launching, np.full(len(grid_s), -1e5)])) == 1


ARRIVED_S = 0.3
PRESSURES_S = 0.01 * np.arange(51.0)
STEPS_S = STEP_S * np.arange(250.0)
CALIBRATION = nominal_calibration()
TOUCH_PA = CALIBRATION.clutches[0].touch_pressure_pa


def signals_of(read_pa: FloatArray, expected_pa: FloatArray | None) -> AlignedSignals:
    """Return signals of clutch 1 that slips at 30 rad/s, its pressure as the sensor reads it and as commanded."""
    still = Resampled(PRESSURES_S, np.zeros(51), STEPS_S)
    return AlignedSignals(
        grid_s=STEPS_S,
        engine_speed=still,
        engine_torque=still,
        hub_speed=still,
        input_speed=(still, still),
        slip_rad_s=(np.full(250, 30.0), np.zeros(250)),
        pressure=(Resampled(PRESSURES_S, read_pa, STEPS_S), still),
        expected_pa=(expected_pa, None),
        oil_k=353.15,
        is_seen=np.ones(250, np.bool_),
    )


def test_no_film_feels_the_pulse_that_fills_its_piston() -> None:
    """The command is at 7 bar while oil flows and the pressure waits; the film closes once that arrives."""
    noise_pa = np.random.default_rng(1).normal(0.0, 4e3, 51)
    read_pa = TOUCH_PA + np.where(PRESSURES_S < ARRIVED_S, -0.5e5, 1e5) + noise_pa
    commanded_pa = np.where((STEPS_S > 0.1) & (STEPS_S < ARRIVED_S - 0.02), 7e5, TOUCH_PA + 1e5)
    signals, laws = signals_of(read_pa, commanded_pa), pack_laws(CALIBRATION)
    measured = measured_drives(signals, Posterior.fresh(CALIBRATION).known.mean, None, 0, laws)
    planned = planned_drives(signals, measured, SlipWindow.of((RowRange(first=150, stop=250),)))
    closed_s = [STEPS_S[np.argmax(integrate_films(one, laws)[0].contact_pa > 0.4e5)] for one in (planned, measured)]
    assert ARRIVED_S < closed_s[0] == pytest.approx(closed_s[1], abs=0.01)
    late = STEPS_S > ARRIVED_S + 0.05
    assert np.array_equal(planned[0].piston_pa[late], commanded_pa[late])  # free of noise where oil has stopped
