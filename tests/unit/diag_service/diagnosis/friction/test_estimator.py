"""The estimator shift by shift: what leaves the running state alone, what enters it, and when it starts afresh."""

from collections.abc import Callable
from dataclasses import astuple, replace

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason
from clutch_results.records import Reason, ShiftEstimate, Status
from diag_service.diagnosis.alignment import usable_samples
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction import Estimator, Posterior
from diag_service.diagnosis.friction.estimator import FULL_WINDOW_S, without_friction, zero_has_jumped
from diag_service.diagnosis.friction.evidence import FRICTION_ROWS, STEP_COUNT, Knowledge, State
from diag_service.diagnosis.friction.posterior import friction
from tests.support.builders import with_latencies
from tests.support.shifts_of_a_drive import changed, first_shifts, thinned

CALIBRATION = nominal_calibration()
ESTIMATOR = Estimator(CALIBRATION)
FRESH = Posterior.fresh(CALIBRATION)
CLUTCH = 2  # the first shift goes to second gear
TOUCH_PA = CALIBRATION.clutches[CLUTCH - 1].touch_pressure_pa
ROWS = FRICTION_ROWS[CLUTCH - 1]


def estimated(event: Event, state: Posterior = FRESH) -> tuple[Posterior, ShiftEstimate]:
    return ESTIMATOR.estimate(event, usable_samples(event), state)


def known(mu_c: float, mu_s: float, std: float = 1e-3) -> Posterior:
    """Return a state that has known the friction of the clutch for some shifts."""
    mean, covariance = FRESH.known.mean.copy(), FRESH.known.covariance.copy()
    mean[ROWS] = mu_c, mu_s
    covariance[ROWS, :] = covariance[:, ROWS] = 0.0
    covariance[ROWS, ROWS] = np.eye(2) * std**2
    return replace(Posterior.of(Knowledge(mean=mean, covariance=covariance), CALIBRATION), folded_counts=(0, 7))


def contradicting(event: Event) -> Event:
    """Return a shift of a clutch with half as much friction again: its pressures are lower for the same torque."""
    for signal in (Signal.CLUTCH2_PRESSURE, Signal.CLUTCH2_PRESSURE_COMMAND):
        event = changed(
            event, signal, lambda _, value: np.where(value > TOUCH_PA, TOUCH_PA + (value - TOUCH_PA) / 1.5, value)
        )
    return event


def test_a_sound_shift_is_valid_and_enters_the_state() -> None:
    event = first_shifts()[0]
    state, estimate = estimated(event)
    assert (estimate.status, estimate.reasons, estimate.clutch) == (Status.VALID, (), CLUTCH)
    assert estimate.friction is not None
    assert estimate.scale_free is not None
    assert state.shift_counts == (0, 1)
    assert state.packs is not None
    assert state.packs.at_ns == event.end_ns
    assert estimate.conditions.clutch_temperature_k == state.packs.clutch_k[CLUTCH - 1]
    assert astuple(friction(state, CLUTCH)) == pytest.approx(astuple(estimate.friction), rel=1e-5)  # nothing else yet
    other = FRICTION_ROWS[0]  # the other clutch was let go
    assert state.known.mean[other] == pytest.approx(FRESH.known.mean[other], abs=1e-3)
    assert state.known.std()[other] == pytest.approx(FRESH.known.std()[other], rel=0.02)
    assert 0.0 < estimate.fit.quality <= 1.0
    assert estimate.fit.window_s > FULL_WINDOW_S


def test_the_own_estimate_of_a_shift_knows_nothing_of_the_running_friction() -> None:
    event = first_shifts()[0]
    _, plain = estimated(event, known(0.14, 0.12))
    _, other = estimated(event, known(0.09, 0.11))
    assert plain.friction is not None
    assert other.friction is not None
    near = 0.2 * plain.friction.std_mu_c  # one is linearised elsewhere than the other
    assert other.friction.mu_c == pytest.approx(plain.friction.mu_c, abs=near)
    assert other.friction.mu_s == pytest.approx(plain.friction.mu_s, abs=near)
    assert other.friction.std_mu_c == pytest.approx(plain.friction.std_mu_c, rel=0.05)


def test_a_shift_whose_data_are_not_believed_is_described_and_leaves_no_trace() -> None:
    event, before = first_shifts()[0], known(0.14, 0.12)
    _, plain = estimated(event, before)
    state, estimate = ESTIMATOR.estimate(event, usable_samples(event), before, (Reason.LOW_DATA_QUALITY,))
    reasons = (Reason.LOW_DATA_QUALITY,)
    assert estimate == replace(plain, status=Status.REJECTED, reasons=reasons, friction=None, scale_free=None)
    assert state is before


def test_three_contradictions_in_a_row_start_the_friction_afresh() -> None:
    event = first_shifts()[0]
    state = before = known(0.20, 0.18)
    for number in range(1, STEP_COUNT):
        state, estimate = estimated(replace(event, number=number), state)
        assert (estimate.status, estimate.reasons) == (Status.VALID, (Reason.NOT_UPDATED,))
        assert estimate.friction is not None
        assert np.array_equal(state.known.mean, before.known.mean)
        assert (state.shift_counts, state.is_used) == ((0, 7), (False,) * number)
    state, estimate = estimated(replace(event, number=STEP_COUNT), state)
    assert (estimate.status, estimate.reasons) == (Status.VALID, ())
    assert (state.shift_counts, state.is_used) == ((0, STEP_COUNT), (True,) * STEP_COUNT)
    assert estimate.friction is not None
    assert friction(state, CLUTCH).mu_c == pytest.approx(0.140, abs=4.0 * friction(state, CLUTCH).std_mu_c)


def test_the_first_events_of_a_vehicle_that_they_make_unlike_its_type_are_left_out() -> None:
    event = first_shifts()[0]
    unlike = with_latencies(6, 0.040)
    assert unlike.is_unlike_type
    state, estimate = estimated(event, unlike)
    told = [(revision.end_bus_ns, revision.status) for revision in estimate.revisions]
    assert told == [(number, Status.REJECTED) for number in range(6)]
    assert replace(state, may_begin_again=True).to_json() == estimated(event)[0].to_json()
    assert estimate.friction == estimated(event)[1].friction


def test_an_agreement_ends_the_row_of_contradictions() -> None:
    event = first_shifts()[0]
    own = friction(estimated(event)[0], CLUTCH)
    state = known(own.mu_c, own.mu_s)
    for number in range(STEP_COUNT - 1):
        state, estimate = estimated(replace(contradicting(event), number=number), state)
        assert estimate.reasons == (Reason.NOT_UPDATED,)
    state, estimate = estimated(replace(event, number=STEP_COUNT), state)
    assert estimate.reasons == ()
    assert state.shift_counts == (0, 8)
    state, estimate = estimated(replace(contradicting(event), number=STEP_COUNT + 1), state)
    assert estimate.reasons == (Reason.NOT_UPDATED,)
    assert state.shift_counts == (0, 8)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda event: replace(event, end_reason=EndReason.INTERRUPTED), Reason.INTERRUPTED),
        (lambda event: replace(event, columns={}), Reason.SIGNAL_MISSING),
        (lambda event: thinned(event, Signal.HUB_SPEED, slice(60, 68)), Reason.FRAMES_MISSING),
        (lambda event: changed(event, Signal.INPUT1_SPEED, lambda _, value: value + 3.0), Reason.SPEEDS_DISAGREE),
        (
            lambda event: changed(event, Signal.ENGINE_TORQUE, lambda t_s, value: np.where(t_s > 0.8, 1e30, value)),
            Reason.OUT_OF_RANGE,
        ),
    ],
)
def test_a_rejected_shift_leaves_the_state_as_it_was(spoil: Callable[[Event], Event], reason: Reason) -> None:
    before = known(0.14, 0.12)
    event = spoil(first_shifts()[0])
    state, estimate = estimated(event, before)
    assert state is before
    assert reason in estimate.reasons
    assert estimate == without_friction(event, Status.REJECTED, *estimate.reasons)


def test_a_zero_that_jumped_rejects_the_shift() -> None:
    zero_known = FRESH.known.covariance.copy()
    zero_known[State.ZERO2, State.ZERO2] = 100.0**2
    before = Posterior.of(Knowledge(mean=FRESH.known.mean, covariance=zero_known), CALIBRATION)
    event = changed(first_shifts()[0], Signal.CLUTCH2_PRESSURE, lambda _, value: value + 0.15e5)
    state, estimate = estimated(event, before)
    assert state.known.mean == pytest.approx(before.known.mean)
    assert (estimate.status, estimate.reasons) == (Status.REJECTED, (Reason.ZERO_JUMPED,))
    assert state.is_used == (False,)  # judged again with those that come


def test_a_shift_that_does_not_fit_warms_its_clutch_and_changes_no_friction() -> None:
    before = known(0.14, 0.12)
    event = changed(
        first_shifts()[0], Signal.ENGINE_TORQUE, lambda t_s, value: value + 120.0 * np.sin(60.0 * t_s) * (t_s > 0.0)
    )
    state, estimate = estimated(event, before)
    assert (estimate.status, estimate.reasons) == (Status.REJECTED, (Reason.MISFIT,))
    assert (estimate.friction, estimate.scale_free, estimate.fit.quality) == (None, None, 0.0)
    assert estimate.fit.chi_square_ratio > 1.0
    assert state.known is before.known
    assert (state.shift_counts, state.recent) == (before.shift_counts, ())
    assert state.packs is not None
    assert state.packs.at_ns == event.end_ns


@pytest.mark.parametrize(("moved_std", "has_jumped"), [(4.9, False), (5.1, True), (-5.1, True)])
def test_a_zero_jumps_when_it_moves_further_than_both_knowledges_allow(moved_std: float, has_jumped: bool) -> None:
    before = FRESH.known
    mean, covariance = before.mean.copy(), before.covariance.copy()
    mean[State.ZERO2] += moved_std * np.sqrt(0.81 * covariance[State.ZERO2, State.ZERO2])
    covariance[State.ZERO2, State.ZERO2] *= 0.19
    assert zero_has_jumped(before, Knowledge(mean=mean, covariance=covariance)) is has_jumped
    assert not zero_has_jumped(before, before)
