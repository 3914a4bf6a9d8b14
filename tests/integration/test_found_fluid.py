"""New fluid that nobody noted and the estimate found: what the old one did is no witness against it."""

from dataclasses import replace
from pathlib import Path

from canlog.logs import read_log
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.condition.verdict import Launches
from diag_service.diagnosis.friction import Posterior
from diag_service.mapping.interpretation import interpret
from diag_service.service.stages import Diagnosis, Stages
from ecu_emulator.cli import main as emulator

JUDDERED = Launches(juddered=(True, True, True, False))


def driven(log: Path, state: Posterior, memory: ConditionMemory) -> Diagnosis:
    """Return the last diagnosis of a drive that began with this state."""
    stages = Stages(interpret(None, None).decoder(), nominal_calibration(), state, memory)
    found = [one for batch in read_log(log) for one in stages.feed(batch)]
    return [*found, *map(stages.conclude, stages.flush())][-1]


def test_launches_with_the_old_fluid_are_forgotten_when_friction_is_found_to_have_changed(tmp_path: Path) -> None:
    old, new = tmp_path / "old.log", tmp_path / "new.log"
    for path, scenario in ((old, "case2"), (new, "noise_only")):
        words = [
            "record",
            str(path),
            "--scenario",
            scenario,
            "--cycles",
            "2",
            "--vehicle-seed",
            "7",
            "--drive-seed",
            "8",
        ]
        assert emulator(words) == 0
    fresh = Posterior.fresh(nominal_calibration())
    before = driven(old, fresh, ConditionMemory.fresh())
    memory = replace(before.memory, launches=(JUDDERED, JUDDERED))
    again = driven(old, before.state, memory)
    assert all(sum(one.juddered) >= 3 for one in again.memory.launches)  # of the same fluid nothing is forgotten
    after = driven(new, before.state, memory)
    assert [sum(one.juddered) for one in after.memory.launches] == [0, 0]
