"""Blind tests: shifts made by the law pass, shifts that no pressure explains are refused, other drives are wider."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from canlog.arrays import FloatArray
from diag_service.diagnosis.blind_test import OURS, BlindTest, blind_test, each_log, levels, scores, second_half
from diag_service.diagnosis.prediction import Prediction, fitted, predicted
from diag_service.diagnosis.slip_phase import SlipPhase
from tests.unit.diag_service.diagnosis.test_prediction import TOUCH_PA, phase


def drive(name: str, seed: int, gain: float = 1.0, count: int = 8) -> list[tuple[str, SlipPhase]]:
    """Make upshifts of a drive whose clutches carry this much of those of the type."""
    rng = np.random.default_rng(seed)
    return [(name, phase(rng, 2 + place % 3, noise_rad_s=2.0, gain=gain)) for place in range(count)]


@cache
def of_the_law() -> BlindTest:
    return blind_test(drive("a", 1), TOUCH_PA)


def test_shifts_of_the_law_pass_and_beat_each_simpler_model() -> None:
    test = of_the_law()
    assert (len(test.shown), test.unknown, test.why_refused) == (8, [], "")
    found = scores(test.shown)
    assert min(found, key=lambda name: found[name]["crps_rad_s"]) == OURS
    assert len(found) == 4


def test_changes_that_no_pressure_explains_are_refused() -> None:
    rng = np.random.default_rng(2)
    named = [
        (log, replace(made, speed_rad_s=600.0 - rng.uniform(500.0, 3000.0) * made.t_s)) for log, made in drive("a", 2)
    ]
    why = blind_test(named, TOUCH_PA).why_refused
    assert "of the best simpler model" in why or "intervals of" in why


def test_too_few_shifts_are_refused() -> None:
    test = blind_test(drive("a", 3, count=4), TOUCH_PA)
    assert [reason for *_, reason in test.unknown] == ["3 others are too few, 4 are needed"] * 4
    assert test.why_refused == "0 are too few to try predictions on, 8 are needed"


def test_a_drive_tells_nothing_of_another_until_two_are_known() -> None:
    alone = blind_test([*drive("a", 4), *drive("b", 5)], TOUCH_PA, each_log)
    assert {reason for *_, reason in alone.unknown} == {
        "learnt from one drive alone: how far another is from it nobody knows"
    }
    assert len(alone.unknown) == 16
    three = [*drive("a", 4, 0.9), *drive("b", 5, 1.1), *drive("c", 6)]
    test = blind_test(three, TOUCH_PA, each_log)
    assert {shift.log for shift in test.shown} == {"a", "b", "c"}
    assert len(test.shown) + len(test.unknown) == 24


def test_intervals_of_another_drive_hold_what_drives_differ_by() -> None:
    logs, phases = zip(*(one for seed in range(4) for one in drive(f"{seed}", seed, 0.8 + 0.13 * seed)), strict=True)
    model = fitted(phases, TOUCH_PA, logs)
    assert model.drive_widening is not None
    assert model.drive_widening > 1.0
    asked = drive("new", 9)[0][1]
    same, other = predicted(model, asked), predicted(model, asked, is_of_another=True)
    assert np.all(other.scale_rad_s >= same.scale_rad_s)


def test_outside_the_trained_range_intervals_widen_and_then_nothing_is_said() -> None:
    model = fitted([one for _, one in drive("a", 7)], TOUCH_PA)
    inside = drive("a", 7)[0][1]
    span_rad_s = model.reach[1, 1] - model.reach[0, 1] or 1.0

    def with_slip(first_rad_s: float) -> SlipPhase:
        return replace(inside, slip_rad_s=np.append(first_rad_s, inside.slip_rad_s[1:]))

    just, far = with_slip(model.reach[1, 1] + 0.5 * span_rad_s), with_slip(model.reach[1, 1] + 1.5 * span_rad_s)
    ratio = predicted(model, just).scale_rad_s / predicted(model, inside).scale_rad_s
    np.testing.assert_allclose(ratio, 1.5)
    assert (model.why_unknown(inside), model.why_unknown(just)) == ("", "")
    assert "too far outside what was learnt" in model.why_unknown(far)


def test_a_gain_whose_sign_is_not_held_predicts_nothing() -> None:
    model = fitted([one for _, one in drive("a", 8)], TOUCH_PA)
    loose = replace(model, covariance=model.covariance + 100.0 * np.eye(6))
    assert "perhaps not even its sign" in loose.why_unknown(drive("a", 8)[0][1])


def test_halves_ask_for_the_second() -> None:
    named = drive("a", 1, count=5)
    ((asked, known),) = second_half(named)
    assert (list(asked), list(known)) == (named[3:], named[:3])


@pytest.mark.parametrize(("true_rad_s", "level"), [(0.0, 0.0), (1.533206274, 0.8), (-2.131846786, 0.9)])
def test_the_level_of_an_interval_is_that_of_a_table_of_t(true_rad_s: float, level: float) -> None:
    said = Prediction(mean_rad_s=np.zeros(1), scale_rad_s=np.ones(1), freedom=4.0)  # quantiles of t, four degrees
    assert levels(said, np.array([true_rad_s]))[0] == pytest.approx(level, abs=1e-6)


def test_intervals_that_hold_too_few_are_refused() -> None:

    def narrow(said: Prediction, true_rad_s: FloatArray) -> Prediction:
        return replace(said, mean_rad_s=1.001 * true_rad_s, scale_rad_s=1e-9 * np.abs(true_rad_s))

    shown = [
        replace(one, predictions={**one.predictions, OURS: narrow(one.predictions[OURS], one.phase.change_rad_s)})
        for one in of_the_law().shown
    ]
    assert BlindTest(shown=shown).why_refused == "intervals of 50 % hold 0 % of the shifts"
