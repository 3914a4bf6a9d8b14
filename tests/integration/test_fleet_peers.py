"""What a fleet teaches, from the database to the table: what is usual, and who ages faster."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from diag_service.diagnosis.records import ShiftResult
from fleet_backend.cli import main
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import fleet_result, row_of
from tests.support.histories import history

CARS = 12


def driven(vehicle: str, count: int, stretch: float) -> list[ShiftResult]:
    """Return results over so many times the distance of the usual history, which is a kilometre a result."""
    results = history(count, vehicle=vehicle)
    return [
        replace(one, estimate=replace(one.estimate, odometer_m=stretch * (one.estimate.odometer_m or 0.0)))
        for one in results
    ]


@pytest.fixture(name="address", scope="module")
def _address(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Store a fleet in which one vehicle's fluid ages three times as fast, and one has another calibration."""
    folder: Path = tmp_path_factory.mktemp("fleet")
    address = f"sqlite:///{folder / 'fleet.sqlite'}"
    engine = open_database(address)
    migrate(engine)
    results = [one for car in range(CARS) for one in driven(f"car{car}", 60 + car, 1000.0)]
    results += driven("fast", 60, 330.0)
    rows = [row_of(one) for one in (*results, fleet_result(1, vehicle="other"))]
    Writer(engine).store(Batch(shifts=rows))
    engine.dispose()
    return address


def test_what_is_usual_is_learned_and_who_is_not_is_named(address: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["peers", "--database", address, "--json"]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    usual = [one for one in records if one["record"] == "usual"]
    clutches = [one for one in records if one["record"] == "clutch"]
    assert {one["channel"] for one in usual} == {"margin", "level"}
    assert {one["life_count"] for one in usual} == {2 * (CARS + 1)}
    assert len(clutches) == 2 * (CARS + 1)
    assert {one["vehicle"] for one in clutches[:2]} == {"fast"}
    assert clutches[0]["loss_ratio"] == pytest.approx(3.0, rel=0.3)
    assert {one["vehicle"] for one in clutches if one["is_faster_than_peers"]} == {"fast"}


def test_people_read_the_same_and_what_is_left_out(address: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["peers", "--database", address]) == 0
    text = capsys.readouterr().out
    assert "learned from 27 clutches; 1 of another calibration are left out" in text
    assert "Faster than their peers: 2 of 26 clutches" in text


def test_a_fleet_of_one_teaches_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    address = f"sqlite:///{tmp_path / 'small.sqlite'}"
    engine = open_database(address)
    migrate(engine)
    Writer(engine).store(Batch(shifts=[row_of(one) for one in history(40)]))
    engine.dispose()
    assert main(["peers", "--database", address]) == 0
    assert "Faster than their peers: 0 of 0 clutches" in capsys.readouterr().out
