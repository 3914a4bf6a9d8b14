"""The story of a vehicle's own calibration in docs/usage.md, played with its own commands; and another vehicle's."""

import json
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import diag_service.cli
import ecu_emulator.cli
from clutch_model.calibration import read_calibration
from ecu_emulator.truth import DriveTruth, read_truth, truth_path
from tests.support.in_process import ended

ROOT = Path(__file__).parents[2]
SECTION = re.compile(r"^## One vehicle's own calibration\n(.*?)^## ", re.MULTILINE | re.DOTALL)
BLOCK = re.compile(r"^```sh\n(.*?)^```", re.MULTILINE | re.DOTALL)
PROGRAMS: Mapping[str, Callable[[Sequence[str]], int]] = {
    "ecu-emulator": ecu_emulator.cli.main,
    "diag-service": diag_service.cli.main,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Played:
    """What the story left behind."""

    folder: Path
    own: dict[str, Any]  # summary of the later drive with the vehicle's own calibration
    nominal: dict[str, Any]  # and with that of its type

    def truth(self, name: str) -> DriveTruth:
        return read_truth(truth_path(self.folder / name)).drive


def story() -> list[list[str]]:
    section = SECTION.search((ROOT / "docs" / "usage.md").read_text(encoding="utf-8"))
    assert section is not None
    block = BLOCK.search(section[1])
    assert block is not None
    return [words for line in block[1].splitlines() if (words := shlex.split(line, comments=True))]


def play(words: Sequence[str]) -> None:
    program, *arguments = words
    assert PROGRAMS[program](arguments) == 0, words


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Played:
    """Play the commands in a folder of their own; the last one is also played without the calibration."""
    folder = tmp_path_factory.mktemp("story")
    *preparation, analysis = story()
    assert analysis[:2] == ["diag-service", "analyze"]
    at = analysis.index("--calibration")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        for words in preparation:
            play(words)
        outcomes = [
            summary(folder / f"{name}.jsonl", words)
            for name, words in (("own", analysis), ("nominal", analysis[:at] + analysis[at + 2 :]))
        ]
    return Played(folder=folder, own=outcomes[0], nominal=outcomes[1])


def summary(path: Path, words: Sequence[str]) -> dict[str, Any]:
    """Return the last line of an analysis as JSON."""
    with pytest.MonkeyPatch.context() as patch, path.open("w", encoding="utf-8") as out:
        patch.setattr("sys.stdout", out)
        play([*words, "--json"])
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    found: dict[str, Any] = lines[-1]
    assert found["schema"] == "clutchdiag/summary/v1"
    return found


def errors(outcome: Mapping[str, Any], truth: DriveTruth) -> list[tuple[float, float]]:
    """Return error and stated deviation of every friction coefficient."""
    pairs = []
    for index, clutch in enumerate(outcome["clutches"]):
        friction = clutch["friction"]
        for name, true in (("mu_c", truth.mu_c[index]), ("mu_s", truth.mu_s[index])):
            pairs.append((friction[name] - true, friction[f"std_{name}"]))
    return pairs


def test_the_later_drive_is_one_of_the_same_vehicle(played: Played) -> None:
    first, later = played.truth("first.log"), played.truth("later.log")
    assert first.drawn == later.drawn
    assert (first.mu_c, first.mu_s) == (later.mu_c, later.mu_s)
    assert first.drive_seed != later.drive_seed
    assert read_truth(truth_path(played.folder / "first.log")).revs
    assert not read_truth(truth_path(played.folder / "later.log")).revs


def test_with_its_own_calibration_friction_is_within_what_is_stated(played: Played) -> None:
    calibration = read_calibration(played.folder / "car7.toml")
    assert {clutch["calibration_version"] for clutch in played.own["clutches"]} != {
        clutch["calibration_version"] for clutch in played.nominal["clutches"]
    }
    assert calibration.version in played.own["clutches"][0]["calibration_version"]
    for error, std in errors(played.own, played.truth("later.log")):
        assert abs(error) < 2.0 * std


def test_its_own_calibration_is_surer_than_that_of_its_type(played: Played) -> None:
    """Which of both errs less on one vehicle is chance; `studies.self_calibration` tells it of many."""
    truth = played.truth("later.log")
    own, nominal = errors(played.own, truth), errors(played.nominal, truth)
    assert all(mine[1] < 0.7 * typical[1] for mine, typical in zip(own, nominal, strict=True))
    assert all(abs(error) < 0.7 * 2.0 * std for (error, _), (_, std) in zip(own, nominal, strict=True))
    assert [clutch["condition"] for clutch in played.own["clutches"]] == ["good", "good"]


def test_a_calibration_names_its_vehicle(played: Played, tmp_path: Path) -> None:
    with (played.folder / "later.log").open(encoding="ascii") as log:
        piece = [line for line, _ in zip(log, range(3_000), strict=False)]
    (tmp_path / "piece.log").write_text("".join(piece), encoding="ascii")
    words = ["diag-service", "analyze", str(tmp_path / "piece.log"), "--calibration", str(played.folder / "car7.toml")]
    assert summary(tmp_path / "piece.jsonl", words)["vehicle"] == "car7"


def test_another_vehicles_calibration_gives_no_verdict(played: Played, tmp_path: Path) -> None:
    """However good the friction looks."""
    log, own, anonymous = tmp_path / "first.log", tmp_path / "car10.toml", tmp_path / "anonymous.toml"
    routine = ["--routine", "2,2", "--vehicle-seed", "10", "--drive-seed", "1"]
    play(["ecu-emulator", "record", str(log), "--scenario", "ideal", *routine])
    play(["diag-service", "calibrate", str(log), "-o", str(own), "--vehicle", "car10"])
    lines = own.read_text(encoding="utf-8").splitlines(keepends=True)
    anonymous.write_text("".join(line for line in lines if not line.startswith("vehicle =")), encoding="utf-8")
    assert read_calibration(anonymous).vehicle is None
    words = ["diag-service", "analyze", str(played.folder / "later.log"), "--calibration", str(anonymous)]
    found = summary(tmp_path / "other.jsonl", words)
    assert [clutch["condition"] for clutch in found["clutches"]] == ["no_verdict", "no_verdict"]
    for clutch in found["clutches"]:
        assert clutch["reason"].startswith("calibration does not fit: ")
        assert "diag-service calibrate" in clutch["reason"]


@pytest.mark.parametrize("command", ["analyze", "calibrate", "run", "config"])
def test_a_calibration_is_refused_for_a_vehicle_that_it_does_not_name(
    command: str, played: Played, tmp_path: Path
) -> None:
    later = str(played.folder / "later.log")
    words = {
        "analyze": ["analyze", later],
        "calibrate": ["calibrate", later, "-o", str(tmp_path / "again.toml")],
        "run": ["run", "-i", "virtual", "-c", "nobody", "--duration", "1"],
        "config": ["config", "check"],
    }[command]
    run = ended(*words, "--calibration", played.folder / "car7.toml", "--vehicle", "car8")
    run.assert_one_line(2, "the calibration is of vehicle car7, not of car8")
