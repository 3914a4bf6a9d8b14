"""The verdict, its thresholds and its hysteresis."""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest

from clutch_model.calibration import TorqueSource, nominal_calibration
from clutch_results.records import ClutchVerdict, Condition, Reason, Status
from diag_service.diagnosis.condition.condition import COLD_K, REFUSED_COUNT, ConditionMemory, Fit, PairClutch, judge
from diag_service.diagnosis.condition.thresholds import Cause, Situation
from diag_service.diagnosis.condition.verdict import (
    LEAST_SHIFT_COUNT,
    SHIFTS,
    SLIP_MINUTES,
    ClutchCourse,
    EventNames,
    KnownLevel,
    Launches,
    decide,
)
from diag_service.diagnosis.friction.drives import PackTemperatures
from diag_service.diagnosis.friction.evidence import (
    FRICTION_COUNT,
    FRICTION_ROWS,
    STATE_COUNT,
    Considered,
    Knowledge,
    State,
)
from diag_service.diagnosis.friction.posterior import BASELINE_SHIFT_COUNT, Baseline, Posterior, friction
from tests.support.builders import rejected, shift_estimate, shift_result

CALIBRATION = nominal_calibration()
LEARNT = [
    *range(State.TORQUE_OFFSET, STATE_COUNT),
    *(STATE_COUNT + of for of in (Considered.VISCOSITY, Considered.TORQUE_LATENCY, Considered.PRESSURE_LATENCY)),
]


def believed(
    mu_c: float, mu_s: float, *, std: float = 0.001, shift_count: int = 5, is_calibrating: bool = False
) -> Posterior:
    """Return a running state with the friction of both clutches known to ``std``."""
    known = Posterior.fresh(CALIBRATION).known
    mean, covariance = known.mean.copy(), known.covariance.copy()
    if not is_calibrating:
        covariance[LEARNT, LEARNT] *= 0.1**2
    mean[:FRICTION_COUNT] = [mu_c, mu_s, mu_c, mu_s]
    covariance[:FRICTION_COUNT, :FRICTION_COUNT] = np.eye(FRICTION_COUNT) * std**2
    state = Posterior.of(Knowledge(mean=mean, covariance=covariance), CALIBRATION)
    return replace(state, folded_counts=(shift_count, shift_count))


def condition_of(state: Posterior, previous: Condition = Condition.NO_VERDICT) -> Condition:
    _, verdict = judge(ConditionMemory(conditions=(previous, previous)), PairClutch.of(state, 1, CALIBRATION))
    return verdict.condition


@pytest.mark.parametrize(
    ("mu_c", "mu_s", "expected"),
    [
        (0.140, 0.119, Condition.GOOD),
        (0.133, 0.125, Condition.WATCH),  # case 1: the margin against shudder is more than halved
        (0.119, 0.137, Condition.CHANGE_FLUID),  # case 2: negative slope
        (0.105, 0.088, Condition.CHANGE_FLUID),  # healthy slope, but a quarter of the torque is gone
        (0.122, 0.104, Condition.WATCH),
    ],
)
def test_known_fluids_get_their_verdict(mu_c: float, mu_s: float, expected: Condition) -> None:
    assert condition_of(believed(mu_c, mu_s)) is expected


def test_one_shift_is_no_verdict() -> None:
    assert condition_of(believed(0.119, 0.137, shift_count=1)) is Condition.NO_VERDICT


def test_an_uncertain_margin_is_no_verdict() -> None:
    assert condition_of(believed(0.140, 0.119, std=0.02)) is Condition.NO_VERDICT


def test_a_certain_shudder_is_told_even_when_the_margin_is_uncertain() -> None:
    assert condition_of(believed(0.10, 0.15, std=0.01)) is Condition.CHANGE_FLUID


def test_a_verdict_stays_until_its_cause_is_unlikely() -> None:
    borderline = believed(0.1295, 0.1285, std=0.001)  # slope negative with probability 0.24
    assert condition_of(borderline) is Condition.WATCH
    assert condition_of(borderline, previous=Condition.CHANGE_FLUID) is Condition.CHANGE_FLUID
    clear = believed(0.133, 0.129, std=0.001)
    assert condition_of(clear, previous=Condition.CHANGE_FLUID) is Condition.WATCH


def test_a_verdict_does_not_stay_for_another_cause_than_its_own() -> None:
    memory, verdict = judge(ConditionMemory(), PairClutch.of(uncertain_scale(believed(0.119, 0.137)), 1, CALIBRATION))
    assert verdict.reason.startswith(Cause.SHUDDER)
    assert ConditionMemory.from_json(memory.to_json()).grounds == (Cause.SHUDDER, None)
    sound_slope = uncertain_scale(believed(0.116, 0.098))  # whose level is low, but not for sure
    low = judge(replace(memory, grounds=(Cause.LEVEL_LOW, None)), PairClutch.of(sound_slope, 1, CALIBRATION))[1]
    assert (low.condition, low.reason.startswith(Cause.LEVEL_LOW)) == (Condition.CHANGE_FLUID, True)
    assert judge(memory, PairClutch.of(sound_slope, 1, CALIBRATION))[1].condition is not Condition.CHANGE_FLUID


def test_what_more_shifts_will_tell_is_not_called_good() -> None:
    """A margin of which a third is left: known well it is watched, known badly nothing is said yet."""
    assert condition_of(believed(0.133, 0.126, std=0.0005)) is Condition.WATCH
    assert condition_of(believed(0.133, 0.126, std=0.004)) is Condition.NO_VERDICT
    assert condition_of(believed(0.140, 0.119, std=0.002)) is Condition.GOOD


def test_half_of_the_margin_is_called_good_only_once_it_is_known_well() -> None:
    """A drive is judged a hundred times: one chance in five each time would be a false word in most drives."""
    assert condition_of(believed(0.1330, 0.1205, std=0.0015)) is Condition.NO_VERDICT
    assert condition_of(believed(0.1330, 0.1205, std=0.0015), Condition.GOOD) is Condition.GOOD
    assert condition_of(believed(0.1330, 0.1205, std=0.0004)) is Condition.GOOD


def test_what_one_clutch_alone_says_early_is_not_called_good_if_the_other_contradicts_it() -> None:
    """Both slip in one oil: a margin that looks like new in one clutch and half gone in the other is neither."""
    state = believed(0.140, 0.119, std=0.0025)
    assert condition_of(state) is Condition.GOOD
    mean = state.known.mean.copy()
    mean[FRICTION_ROWS[1]] = (0.133, 0.124)
    contradicted = Posterior.of(replace(state.known, mean=mean), CALIBRATION)
    assert condition_of(replace(contradicted, folded_counts=(5, 5))) is Condition.NO_VERDICT


def test_what_one_clutch_alone_says_early_is_no_alarm_if_the_other_contradicts_it() -> None:
    """Known better, it is: one lining may be worn where the other is not."""
    for std, expected in ((0.003, Condition.NO_VERDICT), (0.001, Condition.WATCH)):
        state = believed(0.133, 0.127, std=std)
        assert condition_of(state) is Condition.WATCH
        mean = state.known.mean.copy()
        mean[FRICTION_ROWS[1]] = (0.140, 0.119)
        contradicted = Posterior.of(replace(state.known, mean=mean), CALIBRATION)
        assert condition_of(replace(contradicted, folded_counts=(5, 5))) is expected


def test_of_a_margin_hardly_known_a_change_is_said_only_if_it_is_nearly_certain() -> None:
    """A few events may mislead: then 95 % are not enough for a workshop visit."""
    told = {}
    for margin, std in ((-0.0120, 0.004), (-0.0160, 0.004), (-0.0025, 0.0008)):
        state = believed(0.123, 0.123 - margin, std=std)
        told[margin] = friction(state, 1).probability_negative_slope, condition_of(state)
    assert 0.95 < told[-0.0120][0] < 0.99 < told[-0.0160][0]
    assert 0.95 < told[-0.0025][0] < 0.99
    assert [said for _, said in told.values()] == [Condition.NO_VERDICT, *[Condition.CHANGE_FLUID] * 2]


def test_in_the_cold_and_while_a_vehicle_calibrates_a_low_level_must_be_surer_than_a_thin_margin() -> None:
    """A film of unknown law feigns a level: sound cold clutches were said to have 79 % of their friction."""
    for mu_c, mu_s, unsure in ((0.1211, 0.1001, Condition.NO_VERDICT), (0.1330, 0.1255, Condition.WATCH)):
        warm = believed(mu_c, mu_s, std=0.0016)
        cold = replace(warm, packs=PackTemperatures(clutch_k=(COLD_K - 1.0, COLD_K - 1.0), at_ns=1))
        calibrating = believed(mu_c, mu_s, std=0.0016, is_calibrating=True)
        assert condition_of(warm) is Condition.WATCH
        assert condition_of(cold) is condition_of(calibrating) is unsure, mu_c
    shudder = believed(0.123, 0.1255, std=0.0008, is_calibrating=True)
    assert 0.95 < friction(shudder, 1).probability_negative_slope < 0.99
    assert condition_of(shudder) is Condition.CHANGE_FLUID


def test_each_clutch_has_its_own_memory() -> None:
    memory, _ = judge(ConditionMemory(), PairClutch.of(believed(0.119, 0.137), 2, CALIBRATION))
    assert memory.conditions == (Condition.NO_VERDICT, Condition.CHANGE_FLUID)
    assert ConditionMemory.from_json(memory.to_json()).to_json() == memory.to_json()


def aged(ratio: float, *, later_count: int = 10) -> Posterior:
    """Return a state whose friction was at first as in the calibration and is now a share of it, slope healthy."""
    first = believed(0.140, 0.119, shift_count=BASELINE_SHIFT_COUNT).known
    one, other = (
        replace(Baseline.of(clutch, first, end_ns=1, count=BASELINE_SHIFT_COUNT), later_count=later_count)
        for clutch in (1, 2)
    )
    now = believed(0.140 * ratio, 0.119 * ratio, shift_count=BASELINE_SHIFT_COUNT + later_count)
    return replace(now, baselines=(one, other))


def uncertain_scale(state: Posterior) -> Posterior:
    """Return a state whose level says little: the gain of the torque reading may be wrong by a sixth."""
    covariance, gain = state.known.covariance.copy(), STATE_COUNT + Considered.TORQUE_GAIN
    covariance[gain, gain] = 0.16**2
    uncertain = Posterior.of(Knowledge(mean=state.known.mean, covariance=covariance), CALIBRATION)
    return replace(uncertain, folded_counts=state.folded_counts, baselines=state.baselines)


@pytest.mark.parametrize(
    ("ratio", "expected", "by_level_alone"),
    [
        (0.97, Condition.GOOD, Condition.GOOD),
        (0.88, Condition.WATCH, Condition.NO_VERDICT),
        (0.78, Condition.CHANGE_FLUID, Condition.WATCH),
    ],
)
def test_friction_lost_since_the_baseline_is_told_although_the_level_is_uncertain(
    ratio: float, expected: Condition, by_level_alone: Condition
) -> None:
    assert condition_of(uncertain_scale(aged(1.0))) is Condition.GOOD
    state = uncertain_scale(aged(ratio))
    _, verdict = judge(ConditionMemory(), PairClutch.of(state, 1, CALIBRATION))
    assert verdict.condition is expected
    assert ("lost since the baseline" in verdict.reason) is (expected is not Condition.GOOD)
    assert verdict.trend is not None
    assert verdict.trend.change_mu_c_ratio == pytest.approx(ratio - 1.0)
    assert condition_of(replace(state, baselines=(None, None))) is by_level_alone


def test_the_scatter_of_shifts_comes_with_the_verdict_once_there_were_enough() -> None:
    state, memory = believed(0.1361, 0.12), ConditionMemory()
    for number in range(1, LEAST_SHIFT_COUNT + 1):
        assert judge(memory, PairClutch.of(state, 2, CALIBRATION))[1].shift_scatter is None
        memory = memory.with_shift(shift_estimate(number), state)
    scatter = judge(memory, PairClutch.of(state, 2, CALIBRATION))[1].shift_scatter
    assert scatter is not None
    assert scatter.shift_count == LEAST_SHIFT_COUNT
    assert judge(memory, PairClutch.of(state, 1, CALIBRATION))[1].shift_scatter is None
    assert ConditionMemory.from_json(memory.to_json()).to_json() == memory.to_json()


def test_only_shifts_that_entered_the_running_state_scatter() -> None:
    memory, estimate = ConditionMemory(), shift_estimate()
    refused = replace(estimate, reasons=(Reason.NOT_UPDATED,))
    assert memory.with_shift(refused, believed(0.14, 0.12)) is memory
    assert memory.with_shift(rejected(shift_result()).estimate, believed(0.14, 0.12)) is memory
    assert memory.with_shift(replace(estimate, status=Status.REJECTED), believed(0.14, 0.12)) is memory
    assert memory.with_shift(estimate, believed(0.14, 0.12, shift_count=0)) is memory
    assert memory.with_shift(estimate, believed(0.14, 0.12)) != memory


GOOD_MEMORY = ConditionMemory().to_json()


@pytest.mark.parametrize(
    "table",
    [
        {},
        {"conditions": ["FINE", "GOOD"]},
        GOOD_MEMORY | {"conditions": ["FINE", "GOOD"]},
        GOOD_MEMORY | {"conditions": None},
        GOOD_MEMORY | {"format": 1},
        GOOD_MEMORY | {"fits": ["PERHAPS"]},
        GOOD_MEMORY | {"fits": None},
        GOOD_MEMORY | {"scatters": [None]},
        GOOD_MEMORY | {"scatters": [{"variance_mu_c": 1e-6}, None]},
        GOOD_MEMORY | {"scatters": [{"variance_mu_c": -1.0, "variance_mu_s": 1e-6, "shift_count": 3}, None]},
    ],
)
def test_a_damaged_memory_is_refused(table: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"condition memory|impossible scatter"):
        ConditionMemory.from_json(table)


AGREES, CONTRADICTS, MISFITS = Fit.AGREES, Fit.CONTRADICTS, Fit.MISFITS


def after(*reasons: Reason | None) -> ConditionMemory:
    """Return the memory after some shifts, each with the reason against it."""
    memory = ConditionMemory()
    for reason in reasons:
        shift = shift_estimate()
        if reason is Reason.NOT_UPDATED:
            shift = replace(shift, reasons=(reason,))
        elif reason is not None:
            shift = replace(shift, status=Status.REJECTED, reasons=(reason,))
        memory = memory.with_fit(shift)
    return memory


def test_a_shift_says_whether_the_calibration_fits_unless_it_says_nothing() -> None:
    memory = after(None, Reason.MISFIT, Reason.ZERO_JUMPED, Reason.NOT_UPDATED, Reason.FRAMES_MISSING, Reason.SATURATED)
    assert memory.fits == (AGREES, MISFITS, MISFITS, CONTRADICTS)


def test_a_calibration_that_shifts_contradict_gives_no_verdict() -> None:
    fits = (AGREES, MISFITS, AGREES, CONTRADICTS, AGREES, AGREES, MISFITS)
    memory = ConditionMemory(fits=fits)
    assert memory.misfit_text.startswith("calibration does not fit: 3 of the last 7 shifts contradict it")
    assert ConditionMemory.from_json(memory.to_json()).to_json() == memory.to_json()
    memory, verdict = judge(memory, PairClutch.of(believed(0.140, 0.119), 1, CALIBRATION))
    assert (verdict.condition, verdict.reason) == (
        Condition.NO_VERDICT,
        f"{memory.misfit_text}; diag-service calibrate makes one for this vehicle",
    )


@pytest.mark.parametrize(
    "fits",
    [
        (),
        (MISFITS, MISFITS),  # too few to be a share
        (MISFITS,) * 3 + (AGREES,) * 10,  # too small a share
        (AGREES,) * 2 + (CONTRADICTS,) * 6,  # new fluid: three shifts of each clutch
    ],
)
def test_what_sound_drives_may_hold_costs_no_verdict(fits: tuple[Fit, ...]) -> None:
    memory = ConditionMemory(fits=fits)
    assert not memory.misfit_text
    assert judge(memory, PairClutch.of(believed(0.140, 0.119), 1, CALIBRATION))[1].condition is Condition.GOOD


def test_events_whose_sensors_contradict_each_other_take_the_verdict_back_until_one_can_be_used() -> None:
    memory, state = ConditionMemory(), believed(0.14, 0.119)
    ours, other = shift_result().estimate, replace(shift_result().estimate, clutch=1)
    refused = replace(ours, status=Status.REJECTED, reasons=(Reason.PRESSURE_OFF_COMMAND,), friction=None)
    late = replace(refused, reasons=(Reason.FRAMES_MISSING,))
    for one in [refused, late, other] * (REFUSED_COUNT - 1):
        memory = memory.with_fit(one)
    assert judge(memory, PairClutch.of(state, 2, CALIBRATION))[1].condition is Condition.GOOD
    memory = memory.with_fit(refused)
    assert ConditionMemory.from_json(memory.to_json()).refused == (0, REFUSED_COUNT)
    verdict = judge(memory, PairClutch.of(state, 2, CALIBRATION))[1]
    assert (verdict.condition, verdict.causes) == (Condition.NO_VERDICT, None)
    assert verdict.reason.endswith("have them looked at (10 events)")
    assert judge(memory, PairClutch.of(state, 1, CALIBRATION))[1].condition is Condition.GOOD
    assert judge(memory.with_fit(ours), PairClutch.of(state, 2, CALIBRATION))[1].condition is Condition.GOOD


FILLED_AT = "2026-01-01T00:00:00.000000Z"


def test_new_fluid_has_no_verdict_yet_and_does_not_inherit_what_the_old_one_contradicted() -> None:
    fits = (Fit.MISFITS, Fit.CONTRADICTS, Fit.AGREES)
    worn = ConditionMemory(conditions=(Condition.CHANGE_FLUID, Condition.WATCH), fits=fits)
    new = worn.with_new_fluid(FILLED_AT, believed(0.119, 0.137))
    assert new.conditions == (Condition.NO_VERDICT, Condition.NO_VERDICT)
    assert (new.fits, new.fluid_since) == ((Fit.MISFITS, Fit.AGREES), FILLED_AT)
    borderline = believed(0.1295, 0.1285)
    assert judge(worn, PairClutch.of(borderline, 1, CALIBRATION))[1].condition is Condition.CHANGE_FLUID
    assert judge(new, PairClutch.of(borderline, 1, CALIBRATION))[1].condition is Condition.WATCH


def test_what_new_fluid_does_not_bring_back_is_the_linings() -> None:
    worn = aged(0.85)  # fluid and lining together have lost 15 %
    memory = ConditionMemory().with_new_fluid(FILLED_AT, worn)
    assert ConditionMemory.from_json(memory.to_json()).to_json() == memory.to_json()
    _, before = judge(memory, PairClutch.of(believed(0.14, 0.119, shift_count=0), 1, CALIBRATION))
    assert before.lining is None  # no shift with the new fluid yet
    _, verdict = judge(memory, PairClutch.of(believed(0.14 * 0.96, 0.119 * 0.97), 1, CALIBRATION))
    assert verdict.lining is not None
    assert verdict.lining.change_mu_c_ratio == pytest.approx(-0.04)
    assert verdict.lining.change_mu_s_ratio == pytest.approx(-0.03)
    assert 0.0 < verdict.lining.std_change_mu_c_ratio < 0.1
    assert verdict.lining.baseline_shift_count == BASELINE_SHIFT_COUNT


def test_it_says_while_it_learns_the_vehicle() -> None:
    new = believed(0.14, 0.119, is_calibrating=True)
    _, verdict = judge(ConditionMemory(), PairClutch.of(new, 1, CALIBRATION))
    assert verdict.calibration_ratio == 0.0
    assert verdict.reason.endswith(", calibrating: 0 %")
    half, known = new.known.covariance.copy(), new.known.covariance.copy()
    half[FRICTION_COUNT:, FRICTION_COUNT:] *= 0.6**2
    known[FRICTION_COUNT:, FRICTION_COUNT:] *= 0.1**2
    for covariance, ratio, text in ((half, 0.4, "calibrating: 40 %"), (known, 0.9, "")):
        state = replace(Posterior.of(Knowledge(mean=new.known.mean, covariance=covariance), CALIBRATION),
                        folded_counts=(5, 5))  # fmt: skip
        _, verdict = judge(ConditionMemory(), PairClutch.of(state, 1, CALIBRATION))
        assert verdict.calibration_ratio == pytest.approx(ratio)
        assert verdict.reason.endswith(text)
        assert ("calibrating" in verdict.reason) is bool(text)


def modelled(state: Posterior) -> ClutchVerdict:
    return judge(ConditionMemory(), PairClutch.of(replace(state, torque=TorqueSource.MODELLED), 1, CALIBRATION))[1]


def test_without_measured_torque_slope_and_change_are_judged_and_the_level_is_not() -> None:
    sound = modelled(believed(0.14, 0.119))
    assert sound.condition is Condition.NO_VERDICT
    assert [sound.friction, sound.level_ratio, sound.common_scale_std_ratio] == 3 * [None]
    assert sound.slope is not None
    assert sound.slope.mu_s_ratio == pytest.approx(0.85)
    assert sound.slope.probability_negative < 0.01
    assert "engine torque is modelled, not measured: a negative mu-v slope is under 0.1 % likely" in sound.reason
    assert "cannot be called sound" in (sound.advice or "")
    low = modelled(believed(0.10, 0.085))  # of a wrong scale, for all that is known
    assert low.condition is Condition.NO_VERDICT
    shudder = modelled(believed(0.125, 0.137))
    assert shudder.condition is Condition.CHANGE_FLUID
    assert shudder.reason.startswith("shudder (")
    thin = modelled(believed(0.133, 0.130))
    assert (thin.condition, thin.reason.split(" (")[0]) == (Condition.WATCH, "margin against shudder halved")
    lost = modelled(aged(0.7))
    assert (lost.condition, lost.reason.split(" (")[0]) == (
        Condition.CHANGE_FLUID, "too much friction lost since the baseline",
    )  # fmt: skip
    assert modelled(believed(0.125, 0.137, shift_count=2)).condition is Condition.NO_VERDICT


def test_without_measured_torque_a_slope_that_is_hardly_known_is_none() -> None:
    """Sound cold cars were told to change their fluid: mu_S 131 +- 25 % of mu_C, as no lining has it."""
    assert modelled(believed(0.10, 0.15, std=0.01)).condition is Condition.NO_VERDICT


def test_without_measured_torque_a_thin_margin_must_be_surer_in_the_cold() -> None:
    warm = believed(0.133, 0.1265, std=0.0025)  # 84 % likely to be thin
    cold = replace(warm, packs=PackTemperatures(clutch_k=(COLD_K - 1.0, COLD_K - 1.0), at_ns=1))
    assert (modelled(warm).condition, modelled(cold).condition) == (Condition.WATCH, Condition.NO_VERDICT)


@pytest.mark.parametrize(
    ("counted", "situations", "expected"),
    [
        (SHIFTS, (), Condition.CHANGE_FLUID),
        (SHIFTS, (Situation.COLD,), Condition.WATCH),
        (SLIP_MINUTES, (Situation.LOCKUP,), Condition.WATCH),
    ],
)
def test_one_decision_serves_clutches_of_each_kind_and_only_data_differ(
    counted: EventNames, situations: tuple[Situation, ...], expected: Condition
) -> None:
    reference = CALIBRATION.clutches[0].friction
    now, both = friction(believed(0.123, 0.1248, std=0.0005), 1), NormalDist(-0.07, 0.04)
    assert 0.95 < now.probability_negative_slope < 0.99
    course = ClutchCourse(
        counted=counted,
        shift_count=5,
        since=None,
        launches=Launches(),
        previous=Condition.NO_VERDICT,
        previous_cause=None,
        situations=situations,
    )
    found = decide(KnownLevel.of(now, reference, both, course))
    assert (found.condition, f"5 {counted.many}" in found.reason) == (expected, True)
