"""diag-service calibrate, as a user runs it: drive, calibrate, analyse a later drive with the vehicle's own file."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from clutch_model.calibration import nominal_calibration, read_calibration
from tests.support.patience import HANG_S


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *arguments], capture_output=True, text=True, timeout=HANG_S, check=False
    )


@pytest.fixture(scope="module")
def routine_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a drive with scatter that begins with the workshop routine: 2 + 2 revs, one cycle."""
    log = tmp_path_factory.mktemp("calibrate") / "first.log"
    made = run("ecu_emulator", "record", str(log), "--scenario", "ideal", "--seed", "11", "--routine", "2,2")
    assert made.returncode == 0, made.stderr
    return log


def test_a_calibration_is_found_written_and_used(routine_log: Path, cycle_log: Path, tmp_path: Path) -> None:
    own = tmp_path / "car.toml"
    done = run("diag_service", "calibrate", str(routine_log), "-o", str(own), "--vehicle", "car", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
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

    used = run("diag_service", "analyze", str(cycle_log), "--calibration", str(own), "--json", "--vehicle", "car")
    assert used.returncode == 0, used.stderr
    assert calibration.version in used.stdout
    other = run("diag_service", "analyze", str(cycle_log), "--calibration", str(own), "--vehicle", "car2")
    assert other.returncode == 2
    assert "the calibration is of vehicle car, not of car2" in other.stderr


def test_the_table_for_people_says_what_driving_cannot_tell(cycle_log: Path, tmp_path: Path) -> None:
    done = run("diag_service", "calibrate", str(cycle_log), "-o", str(tmp_path / "car.toml"))
    assert done.returncode == 0, done.stderr
    assert "torque latency against the speeds" in done.stdout
    assert "not observable from driving" in done.stdout


def test_too_short_a_drive_is_refused_and_writes_nothing(drive_log: Path, tmp_path: Path) -> None:
    own = tmp_path / "car.toml"
    done = run("diag_service", "calibrate", str(drive_log), "-o", str(own))
    assert done.returncode == 2
    assert "usable shifts onto clutch" in done.stderr
    assert not own.exists()


def test_a_file_that_cannot_be_written_is_a_clear_error(cycle_log: Path, tmp_path: Path) -> None:
    done = run("diag_service", "calibrate", str(cycle_log), "-o", str(tmp_path / "nowhere" / "car.toml"))
    assert done.returncode == 2
    assert "cannot write" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_vehicles_calibration_is_no_start_for_another(routine_log: Path, tmp_path: Path) -> None:
    own, again = tmp_path / "car.toml", tmp_path / "again.toml"
    assert run("diag_service", "calibrate", str(routine_log), "-o", str(own)).returncode == 0
    done = run("diag_service", "calibrate", str(routine_log), "-o", str(again), "--calibration", str(own))
    assert done.returncode == 2
    assert "start from its type" in done.stderr
