"""Tables of signals in every place that takes a log: commands, folders, lakes, pipes and Python; as text and as MF4."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from ecu_emulator.cli import main as emulator
from studies.builders import OF_FRICTION, OUTPUT, written
from tests.support import measurements
from tests.support.in_process import ended
from tests.support.pipes import piped

NAMES = {"csv": "{}", "mf4": "{}\\ETKC:1"}


@pytest.fixture(name="folder", scope="module")
def _folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a drive of 10 gear changes as a table of text and as a measurement, and profiles of both."""
    folder = tmp_path_factory.mktemp("everywhere")
    log, table = folder / "car.log", folder / "csv" / "car.csv"
    table.parent.mkdir()
    assert emulator(["record", str(log), "--seed", "5", "--cycles", "1"]) == 0
    written(log, table, np.random.default_rng(5), rate_hz=50.0, left_out=OUTPUT - OF_FRICTION)
    (folder / "mf4").mkdir()
    measurements.of_table(table, folder / "mf4" / "car.mf4", slow=["Oil Temperature"], names=NAMES["mf4"])
    for kind in NAMES:
        run = ended("signals", folder / kind / f"car.{kind}")
        assert run.status == 0, run.err
        (folder / f"{kind}.toml").write_text(run.out, encoding="utf-8")
    return folder


def results(path: Path) -> list[dict[str, Any]]:
    records = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [record for record in records if "from_gear" in record]


@pytest.mark.parametrize("kind", NAMES)
def test_every_command_takes_a_table(folder: Path, tmp_path: Path, kind: str) -> None:
    table, words = folder / kind / f"car.{kind}", ("--profile", folder / f"{kind}.toml")
    record = json.loads(ended("inspect", table, "--json").out)
    assert {one["message"] for one in record["ids"]} >= {NAMES[kind].format("Clutch 1 Pressure")}
    found = tmp_path / "found.jsonl"
    assert ended("analyze", table, *words, "-o", found).status == 0
    assert [one["status"] for one in results(found)] == ["valid"] * 10
    assert ended("calibrate", table, *words, "-o", tmp_path / "car.toml", "--vehicle", "car7").status == 0
    assert ended("analyze", table, *words, "-o", found, "--force", "--calibration", tmp_path / "car.toml").status == 0
    assert {one["vehicle"] for one in results(found)} == {"car7"}
    assert ended("report", table, *words, "-o", tmp_path / "car.html").status == 0
    assert '"valid": 10' in (tmp_path / "car.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", NAMES)
def test_folders_and_lakes_take_tables(folder: Path, tmp_path: Path, kind: str) -> None:
    lake = ("--lake", tmp_path / "lake") if kind == "csv" else ()
    run = ended("analyze", folder / kind, "--profile", folder / f"{kind}.toml", *lake, "--jobs", "1")
    assert run.status == 0, run.err
    if lake:
        assert pl.read_parquet(tmp_path / "lake" / "shifts").height == 10
    else:
        assert "10 shifts (10 valid)" in run.out


@pytest.mark.parametrize("kind", NAMES)
def test_a_table_through_a_pipe_says_its_columns(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    table, profile = folder / kind / f"car.{kind}", folder / f"{kind}.toml"
    content, name = table.read_bytes(), NAMES[kind].format("Engine Speed")

    def run(*words: str | Path) -> str:
        with piped(monkeypatch, [content[:1000], content[1000:]]):
            done = ended(*words)
        assert done.status == 0, done.err
        return done.out

    assert f'column = "{name}"'.replace("\\", "\\\\") in run("signals", "-")
    assert name in run("inspect", "-")
    run("decode", "-", "-o", tmp_path / "piped.parquet")
    assert ended("decode", table, "-o", tmp_path / "named.parquet").status == 0
    assert pl.read_parquet(tmp_path / "piped.parquet").equals(pl.read_parquet(tmp_path / "named.parquet"))
    assert "10 shifts (10 valid)" in run("analyze", "-", "--profile", profile)


def test_results_of_a_measurement_are_those_of_its_table(folder: Path, tmp_path: Path) -> None:
    found = dict[str, list[dict[str, Any]]]()
    for kind in NAMES:
        output = tmp_path / f"{kind}.jsonl"
        assert (
            ended("analyze", folder / kind / f"car.{kind}", "--profile", folder / f"{kind}.toml", "-o", output).status
            == 0
        )
        found[kind] = results(output)
    for text, channels in zip(found["csv"], found["mf4"], strict=True):
        assert channels["friction"]["mu_c"] == pytest.approx(text["friction"]["mu_c"], rel=1e-3)
