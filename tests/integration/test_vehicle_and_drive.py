"""One seed for the car and another for the drive: the same car may be driven twice."""

import json
from pathlib import Path

import numpy as np
import pytest

from ecu_emulator.cli import main
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.errors import ConfigError
from ecu_emulator.scenario.scenario_file import parse_scenario
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


def test_a_seed_alone_is_that_of_the_car_and_of_the_drive(tmp_path: Path) -> None:
    alone = recorded(tmp_path, "alone", "--seed", "7")
    both = recorded(tmp_path, "both", "--vehicle-seed", "7", "--drive-seed", "7")
    car = recorded(tmp_path, "car", "--seed", "3", "--vehicle-seed", "7", "--drive-seed", "7")
    assert alone.read_bytes() == both.read_bytes() == car.read_bytes()
    truth = read_truth(truth_path(alone)).drive
    assert (truth.seed, truth.vehicle_seed, truth.drive_seed) == (7, 7, 7)


def test_the_drive_draws_driver_noise_and_what_happens_on_the_bus() -> None:
    effects = "[effects]\nframe_loss_ratio = 0.1\n"
    faults = '[[bus_faults]]\nkind = "loss"\nmessage = "TCU_Pressures"\nshare = 0.5\n'
    text = f'name = "x"\nvehicle_seed = 5\ndrive_seed = %d\n{effects}{faults}'
    (first, truth), (later, later_truth) = (frames_of(parse_scenario(text % seed, "x")) for seed in (1, 2))
    assert len(first) != len(later)
    assert truth.shifts[1].t_end_s != later_truth.shifts[1].t_end_s  # the driver
    assert not np.array_equal(first.data[:100], later.data[:100])


@pytest.mark.parametrize("key", ["vehicle_seed", "drive_seed"])
@pytest.mark.parametrize("value", ["-1", "9223372036854775808", '"seven"', "1.5", "true"])
def test_seeds_in_a_file_are_checked(key: str, value: str) -> None:
    with pytest.raises(ConfigError, match=key):
        parse_scenario(f'name = "x"\n{key} = {value}\n', "x")


def test_truth_files_of_before_have_one_seed_for_both(tmp_path: Path) -> None:
    path = truth_path(recorded(tmp_path, "old", "--seed", "4"))
    lines = path.read_text(encoding="utf-8").splitlines()
    drive = json.loads(lines[0])
    del drive["vehicle_seed"], drive["drive_seed"]
    path.write_text("\n".join([json.dumps(drive), *lines[1:]]) + "\n", encoding="utf-8")
    truth = read_truth(path).drive
    assert (truth.vehicle_seed, truth.drive_seed) == (4, 4)
