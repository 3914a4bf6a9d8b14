"""A calibration knows its vehicle; with another vehicle's there is no verdict, however good the friction looks."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import diag_service.cli
import ecu_emulator.cli
from clutch_model.calibration import read_calibration

OWNER, OTHER = "7", "10"  # seeds of two cars


@dataclass(frozen=True, slots=True, kw_only=True)
class Garage:
    """A later drive of one car, and the calibrations of two."""

    later: Path
    own: Path
    other: Path


def record(path: Path, vehicle_seed: str, drive_seed: str, *options: str) -> Path:
    seeds = ("--vehicle-seed", vehicle_seed, "--drive-seed", drive_seed)
    assert ecu_emulator.cli.main(["record", str(path), "--scenario", "ideal", *seeds, *options]) == 0
    return path


@pytest.fixture(scope="module")
def garage(tmp_path_factory: pytest.TempPathFactory) -> Garage:
    folder = tmp_path_factory.mktemp("garage")
    calibrations = []
    for seed in (OWNER, OTHER):
        first = record(folder / f"first{seed}.log", seed, "1", "--routine", "2,2")
        calibrations.append(folder / f"car{seed}.toml")
        calibrated = ["calibrate", str(first), "-o", str(calibrations[-1]), "--vehicle", f"car{seed}"]
        assert diag_service.cli.main(calibrated) == 0
    later = record(folder / "later.log", OWNER, "2", "--cycles", "2")
    return Garage(later=later, own=calibrations[0], other=calibrations[1])


def anonymous(calibration: Path, folder: Path) -> Path:
    """Return a copy that does not say whose it is."""
    lines = calibration.read_text(encoding="utf-8").splitlines(keepends=True)
    copy = folder / f"anonymous-{calibration.name}"
    copy.write_text("".join(line for line in lines if not line.startswith("vehicle =")), encoding="utf-8")
    assert read_calibration(copy).vehicle is None
    return copy


def summary(capsys: pytest.CaptureFixture[str], arguments: Sequence[str]) -> dict[str, Any]:
    capsys.readouterr()
    assert diag_service.cli.main(["analyze", *arguments, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out.splitlines()[-1])
    return found


def test_its_own_calibration_names_the_vehicle_and_gives_a_verdict(
    garage: Garage, capsys: pytest.CaptureFixture[str]
) -> None:
    found = summary(capsys, [str(garage.later), "--calibration", str(garage.own)])
    assert found["vehicle"] == f"car{OWNER}"
    assert [clutch["condition"] for clutch in found["clutches"]] == ["good", "good"]


def test_another_vehicles_calibration_gives_no_verdict(
    garage: Garage, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = summary(capsys, [str(garage.later), "--calibration", str(anonymous(garage.other, tmp_path))])
    assert [clutch["condition"] for clutch in found["clutches"]] == ["no_verdict", "no_verdict"]
    for clutch in found["clutches"]:
        assert clutch["reason"].startswith("calibration does not fit: ")
        assert "diag-service calibrate" in clutch["reason"]


@pytest.mark.parametrize("command", ["analyze", "calibrate", "run", "config"])
def test_a_calibration_is_refused_for_a_vehicle_that_it_does_not_name(
    command: str, garage: Garage, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = {
        "analyze": ["analyze", str(garage.later)],
        "calibrate": ["calibrate", str(garage.later), "-o", str(tmp_path / "again.toml")],
        "run": ["run", "-i", "virtual", "-c", "nobody", "--duration", "1"],
        "config": ["config", "check"],
    }[command]
    calibration = ["--calibration", str(garage.own)]
    assert diag_service.cli.main([*arguments, *calibration, "--vehicle", "car8"]) == 2
    said = capsys.readouterr().err
    assert f"the calibration is of vehicle car{OWNER}, not of car8" in said
    assert said.count("\n") == 1
