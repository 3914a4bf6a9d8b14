"""The friction of a lock-up clutch, told by a drive that was simulated from first principles."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from clutch_model.calibration import shipped_calibration
from clutch_results.event_kinds import EventKind
from clutch_results.records import ClutchVerdict, Condition, Reason, ShiftEstimate, Status
from diag_service.diagnosis.condition.condition import REFUSED_COUNT, ConditionMemory, ConverterClutch, judge
from diag_service.diagnosis.condition.thresholds import Silence
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.lockup.estimator import LockupEstimator, SlipFinder, shudder
from diag_service.diagnosis.lockup.state import MICRO_SLIP_RAD_S, LockupState, samples_of
from studies.converter_car import FLUIDS, ConverterCar, DrivenCar, batches, drawn_car, drive

CALIBRATION = shipped_calibration("lockup")
CONVERTER = CALIBRATION.converter
assert CONVERTER is not None
ESTIMATOR = LockupEstimator(CALIBRATION)


@cache
def driven(fluid: str, seed: int = 900, minutes: float = 15.0) -> tuple[ConverterCar, DrivenCar]:
    rng = np.random.default_rng(seed)
    car = drawn_car(rng, fluid, CALIBRATION)
    return car, drive(car, rng, minutes, CALIBRATION)


@cache
def stretches(fluid: str, seed: int = 900) -> list[Event]:
    finder = SlipFinder(CALIBRATION)
    return [one for batch in batches(driven(fluid, seed)[1].columns) for one in finder.feed(batch)] + finder.flush()


@cache
def diagnosed(fluid: str, seed: int = 900) -> tuple[LockupState, list[tuple[ShiftEstimate, ClutchVerdict]]]:
    state, memory, told = LockupState.fresh(CALIBRATION), ConditionMemory(), []
    for event in stretches(fluid, seed):
        state, estimate, swings = ESTIMATOR.estimate(event, state)
        memory, verdict = judge(
            memory.with_fit(estimate).with_shudder(swings),
            ConverterClutch.of(state, CALIBRATION, swings),
        )
        told.append((estimate, verdict))
    return state, told


def test_slip_whose_sensors_contradict_each_other_takes_the_verdict_back() -> None:
    state, told = diagnosed("worn", 903)
    refused = replace(told[-1][0], status=Status.REJECTED, reasons=(Reason.SPEEDS_DISAGREE,))
    memory = ConditionMemory()
    for count in range(REFUSED_COUNT):
        assert memory.refused == (count, 0)
        assert judge(memory, ConverterClutch.of(state, CALIBRATION, None))[1].condition is Condition.CHANGE_FLUID
        memory = memory.with_fit(refused)
    verdict = judge(memory, ConverterClutch.of(state, CALIBRATION, None))[1]
    assert (verdict.condition, verdict.reason.startswith(Silence.DATA_CONTRADICT)) == (Condition.NO_VERDICT, True)


@pytest.mark.parametrize("seed", [900, 901, 902])
@pytest.mark.parametrize("fluid", FLUIDS)
def test_friction_and_slope_of_a_car_that_nobody_knows(fluid: str, seed: int) -> None:
    car, _ = driven(fluid, seed)
    micro = diagnosed(fluid, seed)[0].micro_slip(None)
    true = car.friction_at(MICRO_SLIP_RAD_S)
    shown = true * car.torque_gain * car.area_ratio
    slope = (car.mu_c - car.mu_s) / car.stribeck_speed_rad_s * np.exp(-MICRO_SLIP_RAD_S / car.stribeck_speed_rad_s)
    assert abs(micro.mu - true) < 3.0 * micro.std_mu
    assert abs(micro.scale_free_mu - shown) < 3.0 * micro.std_scale_free_mu
    assert micro.std_scale_free_mu < 0.02 * true
    assert abs(micro.slope_s_rad - slope) < 3.0 * micro.std_slope_s_rad
    assert micro.slip_s > 120.0


@pytest.mark.parametrize(("fluid", "wrong"), [
    ("new", {Condition.WATCH, Condition.CHANGE_FLUID}),
    ("aged", {Condition.GOOD, Condition.CHANGE_FLUID}),
    ("worn", {Condition.GOOD, Condition.WATCH}),
])  # fmt: skip
def test_no_verdict_is_wrong_at_any_moment(fluid: str, wrong: set[Condition]) -> None:
    assert not wrong & {verdict.condition for _, verdict in diagnosed(fluid)[1]}
    if fluid == "worn":
        assert diagnosed(fluid)[1][-1][1].condition is Condition.CHANGE_FLUID


def test_worn_fluid_shudders_and_a_rough_road_or_a_weak_cylinder_do_not() -> None:
    car, found = driven("worn")
    assert found.true_shudder_s > 10.0
    samples = samples_of(found.columns)
    assert samples is not None
    seen = shudder(samples, CALIBRATION)
    assert seen is not None
    assert seen.seen_count > 5
    assert seen.frequency_hz == pytest.approx(car.driveline_hz, abs=2.5)
    rough = ConverterCar(road_nm=15.0, firing_nm=8.0, driveline_damping=0.02)
    quiet = samples_of(drive(rough, np.random.default_rng(3), 8.0, CALIBRATION).columns)
    assert quiet is not None
    told = shudder(quiet, CALIBRATION)
    assert told is not None
    assert told.window_count > 20
    assert told.seen_count == 0
    assert told.amplitude_rad_s > 0.2  # it does swing


def test_stretches_do_not_depend_on_how_the_stream_was_cut() -> None:
    columns = driven("new")[1].columns
    finder = SlipFinder(CALIBRATION)
    pieces = [one for batch in batches(columns, 0.37) for one in finder.feed(batch)] + finder.flush()
    assert [(one.start_ns, one.end_ns, one.kind) for one in pieces] == [
        (one.start_ns, one.end_ns, one.kind) for one in stretches("new")
    ]
    assert {one.kind for one in pieces} == {EventKind.MICRO_SLIP}
    assert not finder.is_expecting
    first = samples_of(pieces[0].columns), samples_of(stretches("new")[0].columns)
    assert first[0] is not None
    assert first[1] is not None
    assert np.array_equal(first[0].slip_rad_s, first[1].slip_rad_s)


def test_a_state_survives_its_store() -> None:
    state = diagnosed("aged")[0]
    again = LockupState.from_json(state.to_json(), CALIBRATION)
    assert again.to_json() == state.to_json()
    assert again.friction() == state.friction()
    with pytest.raises(ValueError, match="format"):
        LockupState.from_json({"format": 0}, CALIBRATION)
    with pytest.raises(ValueError, match="bad mean"):
        LockupState.from_json({**state.to_json(), "mean": [1.0]}, CALIBRATION)


def test_new_fluid_forgets_friction_and_keeps_the_converter() -> None:
    state = diagnosed("new")[0]
    fresh = state.with_new_fluid()
    assert fresh.shift_count == 0
    assert fresh.covariance[0, 0] > 100.0 * state.covariance[0, 0]
    assert np.array_equal(fresh.mean[6:], state.mean[6:])
    assert np.array_equal(fresh.covariance[6:, 6:], state.covariance[6:, 6:])
