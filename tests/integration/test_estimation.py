"""The estimator on emulated drives: what it finds, and what it refuses."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from canlog.arrays import FloatArray, Series
from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason
from clutch_results.records import Reason, ShiftEstimate, Status, shift_from, shift_record
from diag_service.diagnosis.alignment import usable_samples
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction import Estimator, Posterior
from diag_service.diagnosis.friction.posterior import friction as friction_of
from diag_service.diagnosis.friction.posterior import scale_free
from diag_service.diagnosis.summary import with_revisions
from fleet_contract import Channel
from fleet_contract.schema_check import check_data
from tests.support.builders import drive_scenario, shift_result
from tests.support.shifts_of_a_drive import changed, events_of, without

CALIBRATION = nominal_calibration()
FACTORS = {"ideal": (1.0, 1.0), "case1": (0.95, 1.05), "case2": (0.85, 1.15)}


@cache
def shifts(fluid: str = "ideal", seed: int = 77, cycles: int = 1) -> tuple[Event, ...]:
    """Return the shifts of an emulated drive as the service finds them."""
    return events_of(drive_scenario(fluid=fluid, seed=seed, cycles=cycles), CALIBRATION)[0]


def followed(events: tuple[Event, ...]) -> Iterator[tuple[Posterior, ShiftEstimate]]:
    state, estimator = Posterior.fresh(CALIBRATION), Estimator(CALIBRATION)
    for event in events:
        state, estimate = estimator.estimate(event, usable_samples(event), state)
        yield state, estimate


def cut(series: Series, first_ns: int, stop_ns: int) -> Series:
    keep = (series.t_ns < first_ns) | (series.t_ns >= stop_ns)
    return replace(series, t_ns=series.t_ns[keep], sequence=series.sequence[keep], value=series.value[keep])


@pytest.mark.parametrize("fluid", FACTORS)
def test_friction_is_found_within_its_interval(fluid: str) -> None:
    factor_c, factor_s = FACTORS[fluid]
    outcomes = list(followed(shifts(fluid)))
    assert [estimate.status for _, estimate in outcomes] == [Status.VALID] * 10
    for _, estimate in outcomes:
        free, reference = estimate.scale_free, CALIBRATION.clutches[estimate.clutch - 1].friction
        assert free is not None  # the vehicle has the gain and the areas of its type
        assert abs(free.mu_c - factor_c * reference.mu_c) < 4 * free.std_mu_c
        assert abs(free.mu_s - factor_s * reference.mu_s) < 4 * free.std_mu_s
    state = outcomes[-1][0]
    for clutch in (1, 2):
        friction = friction_of(state, clutch)
        reference = CALIBRATION.clutches[clutch - 1].friction
        assert friction.mu_c == pytest.approx(factor_c * reference.mu_c, rel=0.04)
        assert friction.mu_s == pytest.approx(factor_s * reference.mu_s, rel=0.06)
        assert (friction.slope_s_rad > 0.0) == (fluid != "case2")


def test_a_foreign_bus_without_commands_is_still_estimated() -> None:
    bare = without(without(shifts()[1], Signal.CLUTCH1_PRESSURE_COMMAND), Signal.CLUTCH2_PRESSURE_COMMAND)
    ((_, estimate),) = followed((bare,))
    assert estimate.status is Status.VALID
    assert estimate.scale_free is not None
    assert estimate.scale_free.mu_c == pytest.approx(0.140, abs=4 * estimate.scale_free.std_mu_c)


@pytest.mark.parametrize(
    ("signal", "change", "reason"),
    [
        (Signal.ENGINE_TORQUE, lambda t, value: np.where(t > 0.3, value[0], value), Reason.SENSOR_FROZEN),
        (Signal.ENGINE_TORQUE, lambda t, value: np.where(t > 0.7, value + 80.0, value), Reason.MISFIT),
        (
            Signal.CLUTCH2_PRESSURE,
            lambda t, value: np.where(t > 0.7, value + 1.0e5, value),
            Reason.PRESSURE_OFF_COMMAND,
        ),
        (Signal.HUB_SPEED, lambda t, value: np.where(t > 0.7, value + 20.0, value), Reason.SPEEDS_DISAGREE),
    ],
    ids=["torque frozen", "torque steps", "pressure steps", "speed steps"],
)
def test_a_lying_sensor_is_found_out(
    signal: Signal, change: Callable[[FloatArray, FloatArray], FloatArray], reason: Reason
) -> None:
    ((_, estimate),) = followed((changed(shifts()[0], signal, change),))
    assert estimate.status is Status.REJECTED
    assert estimate.reasons == (reason,)
    assert estimate.friction is None


@pytest.mark.parametrize("signal", BALANCE_SIGNALS)
@pytest.mark.parametrize(
    ("from_s", "until_s"), [(-0.25, 0.1), (-0.25, 1.0), (-1.0, 0.1), (0.3, 0.5), (1.0, 9.0)], ids=str
)
def test_a_signal_that_is_not_there_for_a_while_is_missed_wherever_it_is(
    signal: Signal, from_s: float, until_s: float
) -> None:
    event = shifts()[0]
    first_ns, last_ns = (event.start_ns + round(at_s * 1e9) for at_s in (from_s, until_s))
    gap = {**event.columns, signal: cut(event.columns[signal], first_ns, last_ns)}
    ((_, estimate),) = followed((replace(event, columns=gap),))
    assert estimate.reasons == (Reason.FRAMES_MISSING,)
    assert estimate.friction is None


@pytest.mark.parametrize(("catches_up", "reasons"), [(True, ()), (False, (Reason.TIME_UNSURE,))])
def test_frames_that_are_late_together_are_not_missing(catches_up: bool, reasons: tuple[Reason, ...]) -> None:
    """A stalled gateway hands over 100 ms of frames at once; a sender that hung did not measure in that time."""
    event = shifts()[0]
    stall_ns = event.start_ns + 700_000_000

    def stalled(series: Series) -> Series:
        late_ns = np.maximum(series.t_ns, stall_ns + 100_000_000) if catches_up else series.t_ns + 100_000_000
        return replace(series, t_ns=np.where(series.t_ns > stall_ns, late_ns, series.t_ns))

    late = {signal: stalled(series) for signal, series in event.columns.items()}
    ((_, clean),) = followed((event,))
    ((_, estimate),) = followed((replace(event, columns=late),))
    assert estimate.reasons == reasons
    assert (estimate.friction == clean.friction) is catches_up


@pytest.mark.parametrize(
    ("event", "reason"),
    [
        (lambda event: replace(event, end_reason=EndReason.INTERRUPTED), Reason.INTERRUPTED),
        (lambda event: replace(event, end_reason=EndReason.TOO_LONG), Reason.INTERRUPTED),
        (lambda event: without(event, Signal.HUB_SPEED), Reason.SIGNAL_MISSING),
        (
            lambda event: changed(event, Signal.SUMP_TEMPERATURE, lambda _, value: value * 0 + 200.0),
            Reason.OUT_OF_RANGE,
        ),
    ],
    ids=["interrupted", "too long", "signal missing", "oil too cold"],
)
def test_an_unusable_shift_says_why(event: Callable[[Event], Event], reason: Reason) -> None:
    ((state, estimate),) = followed((event(shifts()[0]),))
    assert (estimate.status, estimate.reasons, estimate.friction) == (Status.REJECTED, (reason,), None)
    assert np.array_equal(state.known.mean, Posterior.fresh(CALIBRATION).known.mean)


def test_new_fluid_is_believed_after_three_shifts_that_agree() -> None:
    old, new = shifts("case2", cycles=3), shifts("ideal", seed=78)
    outcomes = list(followed((*old, *new)))[len(old) :]
    for clutch in (1, 2):
        own = [(state, estimate) for state, estimate in outcomes if estimate.clutch == clutch]
        refused = [Reason.NOT_UPDATED in estimate.reasons for _, estimate in own]
        assert sum(refused) == 2
        state = own[-1][0]
        free = scale_free(state, clutch)
        assert free.mu_c == pytest.approx(0.140, abs=4 * free.std_mu_c)
        assert state.shift_counts[clutch - 1] == 5  # the two that were left out at first are of the new fluid too


def test_a_bad_first_shift_is_named_by_those_that_find_it_out() -> None:
    """It was believed at first: nobody knew better. No sound one is blamed in the end."""
    events = shifts(cycles=2)
    bad = changed(events[0], Signal.ENGINE_TORQUE, lambda _, value: value + 30.0)
    results = [replace(shift_result(), estimate=estimate) for _, estimate in followed((bad, *events[1:]))]
    assert results[0].estimate.reasons == ()
    revised = with_revisions(results)
    assert [place for place, one in enumerate(revised) if one.estimate.reasons] == [0]
    record = shift_record(next(one for one in results if one.estimate.revisions))
    check_data(Channel.SHIFT, record)
    assert shift_from(record).estimate.revisions  # as a store and a message carry it
    assert "revisions" not in shift_record(results[0])
