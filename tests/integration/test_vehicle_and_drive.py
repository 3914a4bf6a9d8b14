"""One seed for the car and another for the drive: the same car may be driven twice."""

from pathlib import Path

from ecu_emulator.cli import main
from ecu_emulator.truth import read_truth, truth_path

SHORT = ("--scenario", "ideal", "--cycles", "1")


def recorded(folder: Path, name: str, *seeds: str) -> Path:
    path = folder / f"{name}.log"
    assert main(["record", str(path), *SHORT, *seeds]) == 0
    return path


def test_two_drives_of_one_vehicle_share_the_car_and_nothing_else(tmp_path: Path) -> None:
    first = recorded(tmp_path, "first", "--vehicle-seed", "7", "--drive-seed", "1")
    later = recorded(tmp_path, "later", "--vehicle-seed", "7", "--drive-seed", "2")
    other = recorded(tmp_path, "other", "--vehicle-seed", "8", "--drive-seed", "1")
    truths = [read_truth(truth_path(path)).drive for path in (first, later, other)]
    assert truths[0].drawn == truths[1].drawn != truths[2].drawn
    assert truths[0].mu_c == truths[1].mu_c
    assert [(truth.vehicle_seed, truth.drive_seed) for truth in truths] == [(7, 1), (7, 2), (8, 1)]
    assert len({path.read_bytes() for path in (first, later, other)}) == 3
