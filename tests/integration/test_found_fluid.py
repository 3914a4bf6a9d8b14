"""New fluid that nobody noted and the estimate found: what the old one did is no witness against it."""

from dataclasses import replace
from pathlib import Path

from canlog.logs import read_log
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.condition.verdict import Launches
from diag_service.mapping.interpretation import interpret
from diag_service.service.stages import Belief, Stages
from ecu_emulator.cli import main as emulator

JUDDERED = Launches(juddered=(True, True, True, False))


def driven(log: Path, before: Belief) -> Belief:
    """Return what is believed after a drive."""
    stages = Stages(interpret(None, None).decoder(), nominal_calibration(), before)
    for batch in read_log(log):
        stages.feed(batch)
    for event in stages.flush():
        stages.conclude(event)
    return stages.belief


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
    before = driven(old, Belief.fresh(nominal_calibration()))
    before = replace(before, memory=replace(before.memory, launches=(JUDDERED, JUDDERED)))
    again = driven(old, before)
    assert all(sum(one.juddered) >= 3 for one in again.memory.launches)  # of the same fluid nothing is forgotten
    after = driven(new, before)
    assert [sum(one.juddered) for one in after.memory.launches] == [0, 0]
