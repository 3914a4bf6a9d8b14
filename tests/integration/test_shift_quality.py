"""A control that has something wrong shifts worse, its error is measured, and mended it shifts as before."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Final

import numpy as np
import pytest

from clutch_model.calibration import clutch_of_gear
from clutch_results.event_kinds import ShiftQuality
from clutch_results.records import ShiftEstimate
from clutch_results.shift_course import course_lines, courses
from diag_service import analyze
from diag_service.mapping.learning import proposed_profile
from ecu_emulator.bus.frames import merge
from ecu_emulator.cli import main as emulator
from ecu_emulator.drive.build import build_vehicle, drive_settings
from ecu_emulator.drive.recording import Drive
from ecu_emulator.plant.powertrain import Powertrain
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario.scenario import Driver, Scenario, Truth
from ecu_emulator.shift_control import tcu_data
from studies.builders import STRETCH_S, new_stages, to_batch, written

SEED = 7
RIGHT_FILL: Final = 0.88  # of the prefill: as torque is asked for the cavity is just full
NOMINAL_OVERLAP_NM: Final = 8.0
NOMINAL_GAIN: Final = 1.08
BAR_PA: Final = 1e5


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One vehicle with one thing wrong."""

    kind: str
    step: float
    seed: int


def scenario_of(case: Case) -> Scenario:
    """Return the drive of a case."""
    kind, plant = case.kind, dict[str, float]()
    rng = np.random.default_rng(case.seed)
    if kind.startswith("filled"):
        plant = {"control.prefill_ratio": RIGHT_FILL + case.step}
    elif kind.startswith("off-going"):
        plant = {"control.overlap_gain_ratio": NOMINAL_GAIN + case.step}
    elif kind.startswith("overlap"):
        plant = {"control.overlap_margin_nm": NOMINAL_OVERLAP_NM + case.step}
    driver = Driver(pedal_ratio=float(rng.uniform(0.35, 0.55)))
    return Scenario(name="quality", seed=case.seed, driver=driver, truth=Truth(plant=plant))


def driven(scenario: Scenario, believed_pa: tuple[float, float]) -> list[ShiftEstimate]:
    """Drive with these touch points believed in, and return the estimates of all changes."""
    drive = Drive(scenario)
    drive.believe(believed_pa)
    frames = merge([stretch.frames for stretch in drive.stretches(STRETCH_S)])
    return [one.estimate for one in new_stages().feed(to_batch(frames))]


def scored(estimates: Sequence[ShiftEstimate]) -> list[tuple[ShiftEstimate, ShiftQuality, float]]:
    """Return the changes that have a score."""
    return [
        (one, one.shift_quality, one.shift_quality.score)
        for one in estimates
        if one.shift_quality is not None and one.shift_quality.score is not None
    ]


def true_fills_s(scenario: Scenario, believed_pa: tuple[float, float]) -> list[float]:
    """Return of every change by how much longer its clutch ought to be filled, as the plant has it."""
    vehicle = build_vehicle(scenario)
    plant = Powertrain(
        vehicle.calibration, vehicle.parameters, drive_settings(scenario), touch_pressures_pa=believed_pa
    )
    pieces = []
    while not plant.finished:
        pieces.append(plant.advance(STRETCH_S))
    rows = np.vstack(pieces)
    phase = rows[:, Col.SHIFT_PHASE]
    starts = np.flatnonzero((phase[1:] == tcu_data.TORQUE) & (phase[:-1] == tcu_data.PREFILL)) + 1
    found = []
    for row in starts:
        clutch = clutch_of_gear(int(rows[row, Col.TARGET_GEAR])) - 1
        law = vehicle.calibration.clutches[clutch]
        stroke_pa = law.piston.spring_rate_n_m * law.piston.fill_stroke_m / law.geometry.piston_area_m2
        pressure_pa = rows[:, Col.PRESSURE1 + clutch]
        command_pa = rows[row - 220 : row, Col.PRESSURE1_COMMAND + clutch]
        end = row - 220 + int(np.flatnonzero(command_pa > law.touch_pressure_pa + BAR_PA)[-1])
        rate_pa_s = (pressure_pa[end] - pressure_pa[end - 30]) / 0.03
        short_pa = law.touch_pressure_pa - pressure_pa[row]
        found.append(max(float(short_pa / rate_pa_s), 0.0) if rate_pa_s < 10 * stroke_pa else np.nan)
    return found


def estimates_of(path: Path) -> list[ShiftEstimate]:
    """Return the estimates of a log, or of a table by the profile that is proposed from it."""
    if path.suffix == ".log":
        return [one.estimate for one in analyze(path).results]
    with tempfile.TemporaryDirectory() as name:
        profile = Path(name) / "proposed.toml"
        profile.write_text(proposed_profile(path), encoding="utf-8")
        return [one.estimate for one in analyze(path, profile=profile).results]


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
        error, std = found[clutch].parts.touch_error_pa, found[clutch].parts.std_touch_error_pa
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
        (quality.parts.fill_error_s, quality.parts.std_fill_error_s, truth)
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
        assert all(getattr(fewer.parts, name) is None for name in missing)
        assert all(getattr(more.parts, name) is not None for name in missing)
        assert fewer.parts.flare_rad_s == pytest.approx(more.parts.flare_rad_s, abs=1.0)
        assert fewer.parts.lock_rate_rad_s2 is not None
    untold = "jerk, torque hole, tie up, fill error, touch error, temperature rise"
    assert course_lines(courses(without)) == [f"Scores are without what the signals do not tell: {untold}."]
    assert not any("without" in line for line in course_lines(courses(whole)))
