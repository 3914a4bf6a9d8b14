"""Lives of emulated cars: what is wrong with them is named, sound ones are called sound; a run tells it to people."""

from pathlib import Path

from clutch_model.calibration import TorqueSource, nominal_calibration
from clutch_results.records import shift_from, shift_record
from dbc.contract import load_contract
from diag_service import analyze
from diag_service.cli import main as service
from diag_service.diagnosis.condition.causes import SOUND, CauseJudge
from diag_service.diagnosis.summary import cause_lines
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Stages
from ecu_emulator.cli import main as emulator
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.faults import CauseKind
from studies.builders import to_batch
from studies.causes import CauseLife, CauseOutcome, lived
from tests.support.builders import drive_scenario

JUDGE = CauseJudge(nominal_calibration())


def test_a_life_ends_with_its_cause_named() -> None:
    (life,) = lived(CauseLife(seed=4711, kinds=(CauseKind.RETURN_SPRING,)))
    outcome = CauseOutcome.of(life, JUDGE)
    assert outcome.is_among(1), outcome.stated
    assert outcome.stated[0][2] > 0.8


def test_a_sound_life_stays_sound() -> None:
    (life,) = lived(CauseLife(seed=4712))
    outcome = CauseOutcome.of(life, JUDGE)
    assert outcome.stated[0][0] == SOUND
    assert not outcome.accused


def test_no_cause_is_named_where_friction_has_no_scale() -> None:
    calibration = nominal_calibration().with_torque(TorqueSource.MODELLED)
    stages = Stages(Decoder(load_contract(), load_profile()), calibration)
    found = stages.feed(to_batch(frames_of(drive_scenario(cycles=7))[0]))
    assert len(found) == 70
    assert {one.verdict.causes for one in found} == {None}
    assert found[-1].estimate.scale_free is not None


def test_an_analysis_tells_causes_to_people_and_programs(tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    assert emulator(["record", str(log), "--cycles", "7", "--seed", "5"]) == 0
    analysis = analyze(log)
    causes = analysis.results[-1].verdict.causes
    assert causes is not None
    assert causes.likely[0].cause == SOUND
    assert cause_lines(causes)[0].startswith("Why: no cause found ")
    record = shift_record(analysis.results[-1])
    assert shift_from(record).verdict.causes == causes
    page = tmp_path / "report.html"
    assert service(["report", str(log), "-o", str(page)]) == 0
    told = page.read_text(encoding="utf-8")
    assert 0 < told.index("over slip speed") < told.index(">Why</h2>") < told.index(">What was not seen</h2>")
    assert analysis.results[20].verdict.causes is None
    assert "causes" not in shift_record(analysis.results[20])["verdict"]  # type: ignore[operator]
