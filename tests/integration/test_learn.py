"""``learn``: the description of an emulated car of other ratios, which ``analyze --vehicle-file`` takes."""

import json
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import diag_service
from clutch_model.calibration import nominal_calibration
from diag_service.mapping.learning import proposed_profile
from diag_service.mapping.vehicle_file import read_description
from ecu_emulator.cli import main as emulator
from ecu_emulator.plant.parameters import plant_table
from studies.builders import written
from tests.support.in_process import ended

GEARS_OF = frozenset({"Current Gear", "Target Gear"})
STEP_STD_RATIO = 0.06


def drawn_ratios(rng: np.random.Generator) -> tuple[list[float], list[float]]:
    """Return the ratios of a gearbox, and the true ones of engine over the output shaft that is measured."""
    gearbox = plant_table()["gearbox"]
    assert isinstance(gearbox, dict)
    gears, finals = (np.array(gearbox[name]) for name in ("gear_ratios", "final_drive_ratios"))
    overall = gears * finals
    steps = overall[:-1] / overall[1:]
    steps = 1.0 + (steps - 1.0) * np.maximum(0.6, 1.0 + rng.normal(0.0, STEP_STD_RATIO / (steps - 1.0)))
    overall = overall[0] / np.concatenate(([1.0], np.cumprod(steps)))
    return (overall / finals).tolist(), (overall / finals[0]).tolist()


def driven(folder: Path, seed: int, gears: Sequence[float]) -> Path:
    """Return the log of an emulated car that goes through its shift cycle."""
    scenario, log = folder / f"{seed}.toml", folder / f"{seed}.log"
    values = ", ".join(f"{one:.6f}" for one in gears)
    scenario.write_text(f'name = "learned"\n[truth.plant.gearbox]\ngear_ratios = [{values}]\n', encoding="utf-8")
    emulator(["record", str(log), "--scenario", str(scenario), "--seed", str(seed), "--cycles", "2"])
    return log


@pytest.fixture(name="car", scope="module")
def _car(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[float]]:
    gears, truth = drawn_ratios(np.random.default_rng(5))
    return driven(tmp_path_factory.mktemp("car"), 5, gears), truth


def test_a_car_of_other_ratios_is_described(car: tuple[Path, list[float]], tmp_path: Path) -> None:
    log, truth = car
    run = ended("learn", log, "-o", tmp_path / "car.toml", "--json")
    assert run.status == 0, run.err
    told = json.loads(run.out)
    for gear, ratio in enumerate(truth, 1):
        one = told["gears"][str(gear)]
        assert abs(one["ratio"] - ratio) < 3.0 * one["std"]
        assert one["std"] < 0.01 * ratio
        assert one["clutch"] == 2 - gear % 2
    assert set(told["pressure_lag_s"]) == {"1", "2"}
    assert told["touch_pressure_pa"] == {}  # this car holds no clutch at standstill
    text = (tmp_path / "car.toml").read_text(encoding="utf-8")
    assert "# clutch 1: touch point assumed: the logs do not tell it" in text
    calibration, gears = read_description(tmp_path / "car.toml")
    assert calibration.clutches == nominal_calibration().clutches
    assert gears is not None
    assert gears.ratios == pytest.approx(truth, rel=5e-3)
    assert set(tomllib.loads(text)["learned"]) >= {"gear 1", "clutch 1", "rates_hz"}
    assert diag_service.learn(log)["gears"] == told["gears"]


def test_a_description_tells_the_gears_of_a_table_without_them(car: tuple[Path, list[float]], tmp_path: Path) -> None:
    log, _ = car
    table, profile, file = tmp_path / "car.csv", tmp_path / "profile.toml", tmp_path / "car.toml"
    written(log, table, np.random.default_rng(5), left_out=GEARS_OF)
    profile.write_text(proposed_profile(table), encoding="utf-8")
    diag_service.learn(table, profile, output=file)
    assert read_description(file).gears is not None
    shifts = changes("analyze", log, "--json")
    assert changes("analyze", table, "--profile", profile, "--vehicle-file", file, "--json") == shifts
    assert len(shifts) >= 10


def changes(*words: str | Path) -> list[tuple[int, int]]:
    run = ended(*words)
    assert run.status == 0, run.err
    records = [json.loads(line) for line in run.out.splitlines()]
    gears = [(one["from_gear"], one["to_gear"]) for one in records if "from_gear" in one]
    return [one for one in gears if one[0] != one[1]]
