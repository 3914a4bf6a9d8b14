"""The estimator shift by shift: what leaves the running state alone, what enters it, and when it starts afresh."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import EndReason, Event
from diag_service.diagnosis.friction import Estimator, FilterState
from diag_service.diagnosis.friction.estimator import FULL_WINDOW_S, REFUSALS_TO_YIELD, without_friction
from diag_service.diagnosis.friction.parameters import State, friction_rows
from diag_service.diagnosis.records import Reason, ShiftEstimate, Status
from tests.unit.diag_service.diagnosis.shifts_of_a_drive import changed, first_shifts, thinned

CALIBRATION = nominal_calibration()
ESTIMATOR = Estimator(CALIBRATION)
FRESH = FilterState.fresh(CALIBRATION)
CLUTCH = 2  # the first shift goes to second gear
ROWS = friction_rows(CLUTCH)


def estimated(event: Event, state: FilterState = FRESH) -> tuple[FilterState, ShiftEstimate]:
    return ESTIMATOR.estimate(event, state)


def known(mu_c: float, mu_s: float, std: float = 1e-3) -> FilterState:
    """Return a state that has known the friction of the clutch for some shifts."""
    mean, covariance, sensitivity = FRESH.mean.copy(), FRESH.covariance.copy(), FRESH.sensitivity.copy()
    mean[ROWS] = mu_c, mu_s
    covariance[ROWS, :] = covariance[:, ROWS] = sensitivity[ROWS, :] = 0.0
    covariance[ROWS, ROWS] = np.eye(2) * std**2
    return replace(FRESH, mean=mean, covariance=covariance, sensitivity=sensitivity, shift_counts=(0, 7))


def test_a_sound_shift_is_valid_and_enters_the_state() -> None:
    event = first_shifts()[0]
    state, estimate = estimated(event)
    assert (estimate.status, estimate.reasons, estimate.clutch) == (Status.VALID, (), CLUTCH)
    assert estimate.friction is not None
    assert estimate.scale_free is not None
    assert state.shift_counts == (0, 1)
    assert state.temperature_ns == event.end_ns
    assert state.clutch_temperature_k is not None
    assert estimate.clutch_temperature_k == state.clutch_temperature_k[CLUTCH - 1]
    own, running = estimate.friction, state.friction(CLUTCH)
    assert running.mu_c == pytest.approx(own.mu_c, abs=1e-3)  # after one shift there is nothing else
    assert np.array_equal(state.mean[friction_rows(1)], FRESH.mean[friction_rows(1)])  # the other clutch was let go
    assert 0.0 < estimate.quality <= 1.0
    assert estimate.window_s > FULL_WINDOW_S


def test_the_own_estimate_of_a_shift_knows_nothing_of_the_running_friction() -> None:
    event = first_shifts()[0]
    _, plain = estimated(event, known(0.14, 0.12))
    _, other = estimated(event, known(0.09, 0.11))
    assert plain.friction == other.friction
    assert plain.scale_free == other.scale_free


def test_a_shift_described_only_says_the_same_and_changes_no_friction() -> None:
    event, before = first_shifts()[0], known(0.14, 0.12)
    _, plain = estimated(event, before)
    state, estimate = ESTIMATOR.estimate(event, before, is_described_only=True)
    assert estimate == plain
    assert np.array_equal(state.mean[ROWS], before.mean[ROWS])
    assert (state.shift_counts, state.refused_counts) == (before.shift_counts, before.refused_counts)
    assert state.temperature_ns == event.end_ns  # its heat is real, whatever its friction


def test_a_shift_described_only_is_not_held_against_the_state() -> None:
    surprising = known(0.30, 0.28)
    _, estimate = ESTIMATOR.estimate(first_shifts()[0], surprising, is_described_only=True)
    assert (estimate.status, estimate.reasons) == (Status.VALID, ())


def test_three_contradictions_in_a_row_start_the_friction_afresh() -> None:
    event = first_shifts()[0]
    state = before = known(0.20, 0.18)
    for refused in range(1, REFUSALS_TO_YIELD):
        state, estimate = estimated(event, state)
        assert (estimate.status, estimate.reasons) == (Status.VALID, (Reason.NOT_UPDATED,))
        assert estimate.friction is not None
        assert np.array_equal(state.mean[ROWS], before.mean[ROWS])
        assert (state.shift_counts, state.refused_counts) == ((0, 7), (0, refused))
    state, estimate = estimated(event, state)
    assert (estimate.status, estimate.reasons) == (Status.VALID, ())
    assert (state.shift_counts, state.refused_counts) == ((0, 1), (0, 0))
    assert estimate.friction is not None
    assert state.friction(CLUTCH).mu_c == pytest.approx(estimate.friction.mu_c, abs=1e-3)


def test_an_agreement_ends_the_row_of_contradictions() -> None:
    event = first_shifts()[0]
    own = estimated(event)[1].scale_free
    assert own is not None
    state = replace(known(own.mu_c, own.mu_s), refused_counts=(1, REFUSALS_TO_YIELD - 1))
    state, estimate = estimated(event, state)
    assert estimate.reasons == ()
    assert (state.shift_counts, state.refused_counts) == ((0, 8), (1, 0))


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda event: replace(event, end_reason=EndReason.INTERRUPTED), Reason.INTERRUPTED),
        (lambda event: replace(event, columns={}), Reason.SIGNAL_MISSING),
        (lambda event: thinned(event, Signal.HUB_SPEED, slice(60, 64)), Reason.FRAMES_MISSING),
        (lambda event: changed(event, Signal.HUB_SPEED, lambda _, value: value + 3.0), Reason.SPEEDS_DISAGREE),
    ],
)
def test_a_rejected_shift_leaves_the_state_as_it_was(spoil: Callable[[Event], Event], reason: Reason) -> None:
    before = known(0.14, 0.12)
    event = spoil(first_shifts()[0])
    state, estimate = estimated(event, before)
    assert state is before
    assert estimate == without_friction(event, Status.REJECTED, reason)


def test_a_zero_that_jumped_rejects_the_shift() -> None:
    zero_known = FRESH.covariance.copy()
    zero_known[State.ZERO2, State.ZERO2] = 100.0**2
    before = replace(FRESH, covariance=zero_known)
    event = changed(first_shifts()[0], Signal.CLUTCH2_PRESSURE, lambda _, value: value + 0.15e5)
    state, estimate = estimated(event, before)
    assert state is before
    assert estimate.reasons == (Reason.ZERO_JUMPED,)


def test_a_shift_that_does_not_fit_warms_its_clutch_and_changes_no_friction() -> None:
    before = known(0.14, 0.12)
    event = changed(
        first_shifts()[0], Signal.ENGINE_TORQUE, lambda t_s, value: value + 120.0 * np.sin(60.0 * t_s) * (t_s > 0.0)
    )
    state, estimate = estimated(event, before)
    assert (estimate.status, estimate.reasons) == (Status.REJECTED, (Reason.MISFIT,))
    assert (estimate.friction, estimate.scale_free, estimate.quality) == (None, None, 0.0)
    assert estimate.chi_square_ratio > 1.0
    assert np.array_equal(state.mean[ROWS], before.mean[ROWS])
    assert (state.shift_counts, state.temperature_ns) == (before.shift_counts, event.end_ns)


def test_a_clutch_that_never_carries_alone_says_nothing() -> None:
    event = changed(first_shifts()[0], Signal.CLUTCH2_PRESSURE, lambda _, value: np.minimum(value, 0.5e5))
    state, estimate = estimated(event, known(0.14, 0.12))
    assert (estimate.status, estimate.reasons) == (Status.UNOBSERVED, (Reason.NO_SLIP_WINDOW,))
    assert state.shift_counts == (0, 7)


def test_bad_frames_cost_quality() -> None:
    event = first_shifts()[0]
    clean, dirty = (estimated(replace(event, bad_frame_count=count))[1] for count in (0, 10))
    assert dirty.quality == pytest.approx(clean.quality / (1.0 + 10 / clean.sample_count))
    assert dirty.friction == clean.friction
