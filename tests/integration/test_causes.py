"""Lives of emulated cars: what is wrong with them is named, sound ones are called sound; a run tells it to people."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import studies.causes
from canlog.logs import read_log
from clutch_model.calibration import TorqueSource, nominal_calibration
from clutch_results.records import Condition, Reason, Status, shift_from, shift_record
from dbc.contract import load_contract
from diag_service import analyze
from diag_service.cli import main as service
from diag_service.diagnosis.condition.causes import SOUND, CauseJudge
from diag_service.diagnosis.summary import cause_lines
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Diagnosis, Stages
from ecu_emulator.cli import main as emulator
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.faults import CauseKind
from studies.builders import new_stages, to_batch
from studies.causes import BETWEEN_NS, CauseLife, CauseOutcome, lived, mean_of, scenario_of

JUDGE = CauseJudge(nominal_calibration())
DRIVES = 4  # with the fault, of ten events each


def test_a_life_ends_with_its_cause_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(studies.causes, "FAULTY_DRIVES", DRIVES)
    (life,) = lived(CauseLife(seed=4711, kinds=(CauseKind.RETURN_SPRING,)))
    outcome = CauseOutcome.of(life, JUDGE)
    assert outcome.is_among(1), outcome.stated
    assert outcome.stated[0][2] > 0.8


def test_a_sound_life_stays_sound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(studies.causes, "FAULTY_DRIVES", DRIVES)
    (life,) = lived(CauseLife(seed=4712))
    outcome = CauseOutcome.of(life, JUDGE)
    assert outcome.stated[0][0] == SOUND
    assert not outcome.accused


def test_a_pressure_sensor_that_drifts_is_named_though_its_last_events_are_refused() -> None:
    """Controlled by its command the pressure stays, so that the clutch seems to change until nothing fits any more."""
    rng, stages, passed_ns, found = np.random.default_rng(7003), new_stages(), 0, list[Diagnosis]()
    for drive in range(9):
        scenario = scenario_of(CauseLife(seed=7003), drive, 0.0, rng)
        sensors, name = dict(scenario.sensors), "clutch1_pressure_pa"
        sensors[name] = replace(sensors[name], gain_ratio=1.0 - 0.07 * min(max((drive - 3) / 4, 0.0), 1.0))
        batch = to_batch(frames_of(replace(scenario, sensors=sensors))[0])
        found += stages.feed(replace(batch, t_ns=batch.t_ns + passed_ns)) + list(map(stages.conclude, stages.flush()))
        passed_ns += int(batch.t_ns[-1] - batch.t_ns[0]) + BETWEEN_NS
    last = [one for one in found if one.estimate.clutch == 1][-1]
    assert (last.estimate.status, last.estimate.reasons) == (Status.REJECTED, (Reason.PRESSURE_OFF_COMMAND,))
    assert last.verdict.condition is Condition.NO_VERDICT
    assert last.verdict.causes is not None
    assert [(one.cause, one.clutch) for one in last.verdict.causes.likely[:1]] == [("pressure-sensor", 1)]


def test_lives_that_do_not_tell_a_quantity_leave_what_others_tell_of_it() -> None:
    """Most cars with water in their oil tell nothing of their pressures: all their events are refused."""
    told, silent = (np.array([0.004, 0.0]), np.array([1e-8, np.inf])), (np.zeros(2), np.full(2, np.inf))
    fit = mean_of([told, silent, silent, told, silent])
    assert fit.mean == pytest.approx([0.004, 0.0])
    assert fit.noise.tolist() == pytest.approx([1e-8, np.inf])
    assert fit.life_count.tolist() == [2, 1]


@pytest.fixture(name="log", scope="module")
def _log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of a sound car with as many events as causes take."""
    log = tmp_path_factory.mktemp("causes") / "drive.log"
    assert emulator(["record", str(log), "--cycles", "7", "--seed", "5"]) == 0
    return log


def test_no_cause_is_named_where_friction_has_no_scale(log: Path) -> None:
    calibration = nominal_calibration().with_torque(TorqueSource.MODELLED)
    stages = Stages(Decoder(load_contract(), load_profile()), calibration)
    found = [stages.conclude(event) for batch in read_log(log) for event in stages.segment(batch)]
    assert len(found) >= 65
    assert {one.verdict.causes for one in found} == {None}
    assert found[-1].estimate.scale_free is not None


def test_an_analysis_tells_causes_to_people_and_programs(log: Path, tmp_path: Path) -> None:
    store, page = tmp_path / "car.sqlite", tmp_path / "report.html"
    analysis = analyze(log, store=store)
    causes = analysis.results[-1].verdict.causes
    assert causes is not None
    assert causes.likely[0].cause == SOUND
    assert cause_lines(causes)[0].startswith("Why: no cause found ")
    record = shift_record(analysis.results[-1])
    assert shift_from(record).verdict.causes == causes
    assert service(["report", str(store), "-o", str(page)]) == 0
    told = page.read_text(encoding="utf-8")
    assert 0 < told.index("over slip speed") < told.index(">Why</h2>") < told.index(">What was not seen</h2>")
    assert analysis.results[20].verdict.causes is None
    assert "causes" not in shift_record(analysis.results[20])["verdict"]  # type: ignore[operator]
