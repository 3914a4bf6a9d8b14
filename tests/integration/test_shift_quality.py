"""A control that has something wrong shifts worse, its error is measured, and mended it shifts as before."""

from pathlib import Path
from statistics import fmean

import numpy as np
import pytest

from studies.scan_tool import written
from studies.shift_quality import Case, driven, estimates_of, scenario_of, scored, true_fills_s
from clutch_model.calibration import clutch_of_gear
from diag_service.diagnosis.condition.shift_course import course_lines, courses
from diag_service.diagnosis.records import ShiftEstimate
from ecu_emulator.cli import main as emulator
from ecu_emulator.drive.build import build_vehicle
from ecu_emulator.scenario.scenario import Scenario

SEED = 7
SOUND = scenario_of(Case(kind="none", step=0.0, seed=SEED))


def touch_pa(scenario: Scenario) -> tuple[float, float]:
    first, second = build_vehicle(scenario).calibration.clutches
    return first.touch_pressure_pa, second.touch_pressure_pa


def mean_score(estimates: list[ShiftEstimate]) -> float:
    return fmean(score for *_, score in scored(estimates))


@pytest.fixture(scope="module", name="sound")
def _sound() -> float:
    return mean_score(driven(SOUND, touch_pa(SOUND)))


@pytest.mark.parametrize("error_pa", [-0.25e5, 0.25e5])
def test_a_wrong_touch_point_is_measured(sound: float, error_pa: float) -> None:
    true_pa = touch_pa(SOUND)
    believed_pa = true_pa[0] + error_pa, true_pa[1] + error_pa
    estimates = driven(SOUND, believed_pa)
    found = {clutch_of_gear(one.to_gear): quality for one, quality, _ in scored(estimates)}
    errors = []
    for clutch in (1, 2):
        error, std = found[clutch].touch_error_pa, found[clutch].std_touch_error_pa
        assert error is not None
        assert std is not None
        assert abs(error + error_pa) < 3.0 * std < 0.2e5
        errors.append(error)
    assert mean_score(estimates) < sound - 8.0
    mended = driven(SOUND, (believed_pa[0] + errors[0], believed_pa[1] + errors[1]))
    assert mean_score(mended) > sound - 3.0


def test_a_clutch_that_is_filled_too_little_is_told_by_how_much(sound: float) -> None:
    scenario = scenario_of(Case(kind="filled too little, share", step=-0.4, seed=SEED))
    estimates = driven(scenario, touch_pa(scenario))
    assert mean_score(estimates) < sound - 8.0
    truths = true_fills_s(scenario, touch_pa(scenario))
    pairs = [
        (quality.fill_error_s, quality.std_fill_error_s, truth)
        for (_, quality, _), truth in zip(scored(estimates), truths, strict=True)
    ]
    assert max(truths) > 0.05
    for error_s, std_s, truth_s in pairs:
        assert error_s is not None
        assert std_s is not None
        assert abs(error_s - truth_s) < 3.0 * std_s


def test_clutches_that_overlap_too_far_work_against_each_other(sound: float) -> None:
    scenario = scenario_of(Case(kind="overlap too large, Nm", step=60.0, seed=SEED))
    found = scored(driven(scenario, touch_pa(scenario)))
    assert fmean(score for *_, score in found) < sound - 8.0
    assert sum("tie_up_nm" in quality.reasons for _, quality, _ in found) >= 8  # of ten


def test_a_log_without_pressures_has_fewer_parts_and_says_so(tmp_path: Path) -> None:
    log, table = tmp_path / "drive.log", tmp_path / "drive.csv"
    assert emulator(["record", str(log), "--seed", "7"]) == 0
    left_out = frozenset({"Clutch 1 Pressure", "Clutch 2 Pressure"})
    written(log, table, np.random.default_rng(7), rate_hz=100.0, jitter_s=0.0, skew_ratio=0.0, left_out=left_out)
    whole, without = estimates_of(log), estimates_of(table)
    missing = {"touch_error_pa", "fill_error_s", "tie_up_nm", "temperature_rise_k"}
    assert len(scored(without)) == len(scored(whole)) == 10
    for (_, more, _), (_, fewer, _) in zip(scored(whole), scored(without), strict=True):
        assert all(getattr(fewer, name) is None for name in missing)
        assert all(getattr(more, name) is not None for name in missing)
        assert fewer.flare_rad_s == pytest.approx(more.flare_rad_s, abs=1.0)
        assert fewer.lock_rate_rad_s2 is not None
    untold = "jerk, torque hole, tie up, fill error, touch error, temperature rise"
    assert course_lines(courses(without)) == [f"Scores are without what the signals do not tell: {untold}."]
    assert not any("without" in line for line in course_lines(courses(whole)))
