"""Which cause is named for what moved, why, and what would tell more; what is remembered, and when it is forgotten."""

from dataclasses import replace

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from clutch_results.records import Causes, Condition, LikelyCause, to_plain
from diag_service.diagnosis.condition.causes import ELSE, SOUND, CauseJudge, described
from diag_service.diagnosis.condition.condition import (
    BEGIN_COUNT,
    LEAST_COUNT,
    LOWER,
    MEASURED,
    ConditionMemory,
    PairClutch,
    Stretch,
    VehicleCourse,
    judge,
)
from diag_service.diagnosis.friction.evidence import FRICTION_COUNT, NAMES, PARAMETER_COUNT
from diag_service.diagnosis.friction.posterior import Posterior
from tests.support.builders import rejected, shift_result

CALIBRATION = nominal_calibration()
JUDGE = CauseJudge(CALIBRATION)
FRESH = Posterior.fresh(CALIBRATION)
USUAL = {"pressure_lag_s": 0.026, "pressure_reach_ratio": 0.975, "pressure_short_pa": 6e3, "fill_time_s": 0.2,
         "believed_touch_pa": 1.4e5}  # fmt: skip
SCATTER = {"pressure_lag_s": 0.003, "pressure_reach_ratio": 0.015, "pressure_short_pa": 3e3, "fill_time_s": 0.01,
           "believed_touch_pa": 200.0}  # fmt: skip


def stretch(moved: dict[str, float] | None = None) -> Stretch:
    """Return forty events of a car in which this has moved: parameters by name, measures with their clutch behind."""
    moved, std = moved or {}, FRESH.base.std()
    std[:FRICTION_COUNT] = 0.01
    at = FRESH.base.mean.copy()
    for name, size in moved.items():
        if name in NAMES:
            at[NAMES.index(name)] += size
    information = np.diag(1.0 / np.maximum(0.3 * std, 1e-9) ** 2)
    sums = np.zeros((2, len(MEASURED) + 1, 3))
    for clutch in (0, 1):
        for row, name in enumerate(MEASURED):
            mean = USUAL[name] + moved.get(f"{name}{clutch + 1}", 0.0)
            sums[clutch, row] = 20.0, 20.0 * mean, 20.0 * (mean**2 + SCATTER[name] ** 2)
        sums[clutch, -1] = 20.0, 0.0, 20.0 * (0.015 * moved.get("scatter", 1.0)) ** 2
    return Stretch(count=BEGIN_COUNT, lower=information[LOWER], vector=information @ at, sums=sums)


def causes_of(moved: dict[str, float] | None = None, *, filled: bool = False) -> Causes:
    now = stretch(moved)
    return JUDGE.judge(VehicleCourse(begun=stretch(), now=now, filled=now if filled else None, event_count=150))


def first(causes: Causes) -> tuple[str, int | None]:
    return causes.likely[0].cause, causes.likely[0].clutch


def test_a_car_in_which_nothing_moved_is_sound() -> None:
    causes = causes_of()
    assert first(causes) == (SOUND, None)
    assert causes.likely[0].probability > 0.9
    assert causes.advice == "No cause found: what the verdict says stands."
    assert causes.test is None
    assert causes.event_count == 150 - BEGIN_COUNT


AGED = {"mu_c1": -0.014, "mu_s1": 0.012, "mu_c2": -0.014, "mu_s2": 0.012}
GLAZED = {"mu_c{}": -0.0168, "mu_s{}": -0.0143, "film_mobility": -0.25, "torque_gain": -0.03, "engine_inertia": -0.02}
WORN = {"touch{}": 1e4, "believed_touch_pa{}": 9e3, "fill_time_s{}": 0.05, "pressure_latency": 0.003}
SPRING = {"touch{}": -1.4e4, "believed_touch_pa{}": -1.45e4, "fill_time_s{}": 0.06, "scatter": 1.8}
PRESSURE = {"pressure_reach_ratio{}": 0.08, "pressure_short_pa{}": -5.7e4, "fill_time_s{}": -0.036,
            "stribeck_exponent": -0.4, "open_drag": 1.4, "torque_gain": 0.05}  # fmt: skip
SCALE = {f"mu_{kind}{clutch}": 0.08 * level for kind, level in (("c", 0.14), ("s", 0.119)) for clutch in (1, 2)}
DRIFTED = {**SCALE, "torque_offset": 2.0, "torque_gain": 0.05, "engine_inertia": 0.06}  # as in emulated cars


@pytest.mark.parametrize(
    ("cause", "clutch", "moved"),
    [
        ("aged-fluid", None, AGED),
        ("torque-sensor", None, DRIFTED),
        ("glazed-lining", 1, GLAZED),
        ("glazed-lining", 2, GLAZED),
        ("worn-lining", 1, WORN),
        ("worn-lining", 2, WORN),
        ("return-spring", 1, SPRING),
        ("return-spring", 2, SPRING),
        ("pressure-sensor", 1, {**PRESSURE, "mu_s2": -0.005}),
        ("pressure-sensor", 2, {**PRESSURE, "mu_s1": -0.005}),
    ],
)
def test_a_cause_is_named_with_its_clutch(cause: str, clutch: int | None, moved: dict[str, float]) -> None:
    causes = causes_of({name.format(clutch): size for name, size in moved.items()})
    assert first(causes) == (cause, clutch)
    assert causes.likely[0].probability > 0.5
    assert causes.likely[0].evidence.startswith("For it: ")
    assert "nothing by itself" not in causes.likely[0].evidence


def test_another_fluid_is_named_only_where_one_was_filled_in() -> None:
    moved = {"mu_c1": -0.011, "mu_s1": 0.010, "mu_c2": -0.011, "mu_s2": 0.010, "viscosity": 0.3}
    chance = [
        sum(one.probability for one in causes_of(moved, filled=filled).likely if one.cause == "wrong-fluid")
        for filled in (False, True)
    ]
    assert chance[1] > 0.5
    assert chance[0] < chance[1]


@pytest.mark.parametrize("filled", [False, True])
def test_new_fluid_after_aged_fluid_is_no_fault(*, filled: bool) -> None:
    now = stretch()
    course = VehicleCourse(begun=stretch(AGED), now=now, filled=now if filled else None, event_count=150)
    causes = JUDGE.judge(course)
    assert first(causes) == ("renewed-fluid", None)
    assert causes.likely[0].probability > (0.9 if filled else 0.5)
    told = causes.likely[0].evidence
    assert "friction of clutch 1 +11 ±" in told
    assert "e+" not in told


@pytest.mark.parametrize(
    ("moved", "cause"), [(GLAZED, ("glazed-lining", 1)), (AGED, ("aged-fluid", None)), (SCALE, (SOUND, None))]
)
def test_what_was_there_before_the_first_event_is_told_by_the_type(
    moved: dict[str, float], cause: tuple[str, int | None]
) -> None:
    always = stretch({name.format(1): size for name, size in moved.items()})
    causes = JUDGE.judge(VehicleCourse(begun=always, now=always, event_count=150))
    assert first(causes) == cause
    assert sum(one.probability for one in causes.likely) == pytest.approx(1.0, abs=0.2)
    assert causes.likely[0].evidence.startswith("There from the beginning. For it: ") is (cause[0] != SOUND)


def test_friction_that_changes_in_the_beginning_begins_it_again() -> None:
    early = ConditionMemory(course=VehicleCourse(begun=replace(stretch(), count=BEGIN_COUNT - 1.0), event_count=39))
    assert to_plain(early.with_changed_friction(2).course) == to_plain(VehicleCourse())
    later = VehicleCourse(begun=stretch(), now=stretch(), event_count=100, found=causes_of(AGED))
    assert to_plain(later.with_changed_friction()) == to_plain(replace(later, now=Stretch(), found=None))
    drifted = replace(later, found=causes_of(DRIFTED))
    assert drifted.sensor_share(1) > 0.5
    assert to_plain(drifted.with_changed_friction()) == to_plain(replace(drifted, now=Stretch()))


def test_what_fits_nothing_is_something_else() -> None:
    causes = causes_of({"friction_temperature": 0.004})
    assert first(causes) == (ELSE, None)
    assert "friction over temperature" in causes.likely[0].evidence
    assert causes.advice.startswith("Something has changed that fits no known cause")


def test_every_pair_of_causes_has_a_test_or_is_told_by_driving() -> None:
    causes = list(described()["cause"])
    untold = []
    for one in causes:
        for other in causes:
            pair = tuple(LikelyCause(cause=k, clutch=None, probability=0.4, evidence="x") for k in (one, other))
            if one < other and JUDGE.test_between(pair) is None:
                untold.append((one, other))
    assert untold == []


def test_a_course_survives_its_store_and_damage_is_found() -> None:
    found = causes_of({name.format(1): size for name, size in GLAZED.items()})
    memory = ConditionMemory(course=VehicleCourse(begun=stretch(), now=stretch(AGED), event_count=90, found=found))
    again = ConditionMemory.from_json(memory.to_json())
    assert again.to_json() == memory.to_json()
    damaged = memory.to_json()
    course = damaged["course"]
    assert isinstance(course, dict)
    assert isinstance(course["now"], dict)
    course["now"]["vector"] = [0.0] * (PARAMETER_COUNT - 1)
    with pytest.raises(ValueError, match="impossible course"):
        ConditionMemory.from_json(damaged)


@pytest.mark.parametrize(("clutch", "is_held"), [(1, True), (2, False)])
def test_a_drifted_sensor_holds_back_the_verdict_on_its_clutch(clutch: int, is_held: bool) -> None:
    drifted = LikelyCause(cause="pressure-sensor", clutch=1, probability=0.8, evidence="For it: x.")
    found = Causes(event_count=60, likely=(drifted,), advice="x")
    memory = ConditionMemory(course=VehicleCourse(begun=stretch(), now=stretch(), event_count=100, found=found))
    _, verdict = judge(memory, PairClutch.of(FRESH, clutch, CALIBRATION))
    assert verdict.condition is Condition.NO_VERDICT
    assert ("has probably drifted" in verdict.reason) is is_held
    assert verdict.causes == found


def test_of_events_without_friction_no_cause_is_told() -> None:
    """A car of which no friction is measured would pass for one with which nothing is wrong."""
    silent = rejected(shift_result()).estimate
    course = VehicleCourse()
    for _ in range(90):
        course = course.with_event(silent, FRESH, FRESH)
        assert not course.is_due
    assert course.now.count > LEAST_COUNT
