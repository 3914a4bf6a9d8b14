"""diag-service calibrate, as a user runs it: what it finds of the drawn vehicle; test_calibrate_story.py uses it."""

import json
from pathlib import Path

import pytest

from clutch_model.calibration import nominal_calibration, read_calibration
from diag_service.api.calibration import find_events
from diag_service.mapping.interpretation import interpret
from diag_service.service.drive import open_drive
from diag_service.stopping import Trigger
from ecu_emulator.cli import main as emulator
from tests.support.asked import write_candump
from tests.support.chain import frames_of_log
from tests.support.in_process import ended as run
from tests.support.lateness import after_stalls


@pytest.fixture(scope="module")
def routine_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a drive with scatter that begins with the workshop routine: 2 + 2 revs, one cycle."""
    log = tmp_path_factory.mktemp("calibrate") / "first.log"
    assert emulator(["record", str(log), "--scenario", "ideal", "--seed", "11", "--routine", "2,2"]) == 0
    return log


def test_what_is_written_is_what_the_vehicle_drew(routine_log: Path, tmp_path: Path) -> None:
    own = tmp_path / "car.toml"
    done = run("calibrate", str(routine_log), "-o", str(own), "--vehicle", "car", "--json")
    assert done.status == 0, done.err
    found = json.loads(done.out)
    calibration = read_calibration(own)
    assert found["calibration_version"] == calibration.version
    assert calibration.version.startswith(f"{nominal_calibration().version}-car-")
    assert calibration.made_on is not None
    assert found["shift_counts"] == [5, 5]
    assert found["rev_counts"] == [2, 2]
    drawn = json.loads(Path(f"{routine_log}.truth.jsonl").read_text(encoding="utf-8").splitlines()[0])["drawn"]
    for name, key in (("torque_offset", "torque_offset_nm"), ("zero1", "clutch1_pressure_zero_pa")):
        parameter = found["parameters"][name]
        assert abs(parameter["value"] - drawn[key]) < 4.0 * parameter["std"]
        assert parameter["std"] < parameter["std_before"]


def test_a_log_that_ends_in_a_burst_is_used_to_its_end(routine_log: Path, tmp_path: Path) -> None:
    log, frames = tmp_path / "late.log", frames_of_log(routine_log, 60.0)
    write_candump(log, after_stalls(frames, [((frames.t_ns[-1] - frames.t_ns[0]) / 1e9 - 0.1, 0.09)], 0.0))
    decoder = interpret(None, None).decoder()
    with open_drive([log]) as logs:
        assert find_events(logs, decoder, nominal_calibration(), Trigger()).shifts
    assert decoder.counts.on_bus == len(frames)
