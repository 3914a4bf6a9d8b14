"""Lives of emulated cars: what is wrong with them is named, sound ones are called sound; a run tells it to people."""

from pathlib import Path

import pytest

from benchmarks.causes import Life, Outcome, lived
from clutch_model.calibration import nominal_calibration
from diag_service import analyze
from diag_service.diagnosis.condition.causes import SOUND, CauseJudge
from diag_service.diagnosis.records import shift_from, shift_record
from diag_service.diagnosis.summary import cause_lines
from ecu_emulator.cli import main as emulator
from ecu_emulator.scenario.faults import CauseKind

JUDGE = CauseJudge(nominal_calibration())


@pytest.mark.parametrize("kind", [CauseKind.PRESSURE_SENSOR, CauseKind.RETURN_SPRING, CauseKind.AGED_FLUID])
def test_a_life_ends_with_its_cause_named(kind: CauseKind) -> None:
    (life,) = lived(Life(seed=4711, kinds=(kind,)))
    outcome = Outcome.of(life, JUDGE)
    assert outcome.is_among(1), outcome.stated
    assert outcome.stated[0][2] > 0.8


def test_a_sound_life_stays_sound() -> None:
    (life,) = lived(Life(seed=4712))
    outcome = Outcome.of(life, JUDGE)
    assert outcome.stated[0][0] == SOUND
    assert not outcome.accused


def test_an_analysis_tells_causes_to_people_and_programs(tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    assert emulator(["record", str(log), "--cycles", "7", "--seed", "5"]) == 0
    analysis = analyze(log)
    causes = analysis.results[-1].verdict.causes
    assert causes is not None
    assert causes.likely[0].cause == SOUND
    assert cause_lines(causes)[0].startswith("Why: sound ")
    record = shift_record(analysis.results[-1])
    assert shift_from(record).verdict.causes == causes
    assert analysis.results[20].verdict.causes is None
    assert "causes" not in shift_record(analysis.results[20])["verdict"]  # type: ignore[operator]
