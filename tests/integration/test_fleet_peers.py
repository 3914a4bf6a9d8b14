"""What a fleet teaches, from the database to the table: what is usual, and which lots age faster."""

import json
import shutil
import sqlite3
from dataclasses import replace
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path

import pytest
from sqlalchemy import Engine, select

from diag_service.diagnosis.prognosis import Population, population_from
from diag_service.diagnosis.records import ShiftResult
from fleet_backend.cli import main
from fleet_backend.database import open_database, transaction
from fleet_backend.errors import DatabaseError
from fleet_backend.lots import LotRow, lots_of, store_lots
from fleet_backend.migrate import migrate
from fleet_backend.office_tables import AUDIT
from fleet_backend.page.outlook import outlook_of
from fleet_backend.page.past import results_of
from fleet_backend.page.populations import keep, latest
from fleet_backend.report import lot_standings_table, show
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import fleet_result, row_of
from tests.support.histories import history

CARS = 14
FAST = ("fast0", "fast1", "fast2")


def driven(vehicle: str, count: int, stretch: float) -> list[ShiftResult]:
    """Return results over so many times the distance of the usual history, which is a kilometre a result."""
    results = history(count, vehicle=vehicle)
    return [
        replace(one, estimate=replace(one.estimate, odometer_m=stretch * (one.estimate.odometer_m or 0.0)))
        for one in results
    ]


@pytest.fixture(name="fleet", scope="module")
def _fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Store a fleet in which the fluid of one lot ages three times as fast, and one vehicle has another calibration."""
    path: Path = tmp_path_factory.mktemp("fleet") / "fleet.sqlite"
    engine = open_database(f"sqlite:///{path}")
    migrate(engine)
    results = [one for car in range(CARS) for one in driven(f"car{car}", 40 + car, 1000.0)]
    results += [one for car in FAST for one in driven(car, 50, 330.0)]
    rows = [row_of(one) for one in (*results, fleet_result(1, vehicle="other"))]
    Writer(engine).store(Batch(shifts=rows))
    engine.dispose()
    return path


@pytest.fixture(name="address")
def _address(fleet: Path, tmp_path: Path) -> str:
    """Return a database of that fleet that is the test's own."""
    return f"sqlite:///{shutil.copy(fleet, tmp_path)}"


@pytest.fixture(name="table")
def _table(tmp_path: Path) -> Path:
    lines = ["vehicle,fluid lot,plant", *(f"car{car},{car % 2},north" for car in range(CARS))]
    lines += [f"{car},B7,north" for car in FAST]
    path = tmp_path / "lots.csv"
    path.write_text("\n".join([*lines, "unheard,B7,"]) + "\n", encoding="utf-8")
    return path


def test_what_is_usual_is_learned_kept_and_used_and_bad_lots_are_named(
    address: str, table: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["lots", "--database", address, "--read", str(table)]) == 0
    assert capsys.readouterr().out == "35 properties of 18 vehicles; of 1 of them have not been heard from\n"
    written = tmp_path / "peers.json"
    assert main(["peers", "--database", address, "--json", "--keep", "--write", str(written)]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    usual = [one for one in records if one["record"] == "usual"]
    lots = [one for one in records if one["record"] == "lot"]
    assert {one["channel"] for one in usual} == {"margin", "level"}
    assert {one["life_count"] for one in usual} == {2 * (CARS + len(FAST))}
    assert {one["record"] for one in records} == {"usual", "lot", "population"}
    assert [(one["name"], one["value"]) for one in lots if one["is_faster_than_others"]] == [("fluid lot", "B7")]
    assert records[-1] == {"record": "population", "version": 1}

    engine = open_database(address)
    kept = latest(engine)
    assert kept is not None
    with transaction(engine) as connection:
        audit = connection.execute(select(AUDIT.c.action, AUDIT.c.subject).order_by(AUDIT.c.at)).all()
    assert [tuple(one) for one in audit] == [
        ("read lots", "35 properties of 18 vehicles"),
        ("keep population", "population 1, from 35 clutches"),
    ]
    assert kept.population == population_from(json.loads(written.read_text(encoding="utf-8")))
    rows = results_of(engine, "car0", 2)
    among, alone = (outlook_of(2, rows, (), 1.5e7, one) for one in (kept, None))
    engine.dispose()
    assert among is not None
    assert alone is not None
    assert any("(population 1)" in line for line in among.assumptions)
    assert not any("population" in line for line in alone.assumptions)
    assert among.change_fluid != alone.change_fluid


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("car,lot\na,1\n", "the header must name"),
        ("vehicle,lot\na,1,2\n", "line 2: 3 values for 2 columns"),
        ("vehicle,lot\na,1\na,2\n", "line 3: the vehicle is missing or listed twice"),
        ("vehicle,lot\na,\x07\n", "is not a word"),
        ("vehicle,lot\na," + 201 * "x" + "\n", "is not a word"),
    ],
)
def test_a_table_that_is_none_changes_nothing(
    address: str, table: Path, text: str, complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["lots", "--database", address, "--read", str(table)]) == 0
    table.write_text(text, encoding="utf-8")
    assert main(["lots", "--database", address, "--read", str(table)]) == 2
    assert complaint in capsys.readouterr().err
    assert main(["lots", "--database", address, "--json"]) == 0
    known = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {"vehicle": "fast1", "name": "fluid lot", "value": "B7"} in known


def test_an_empty_cell_is_forgotten(address: str, table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["lots", "--database", address, "--read", str(table)]) == 0
    table.write_text("vehicle,plant\nfast1,\n", encoding="utf-8")
    assert main(["lots", "--database", address, "--read", str(table)]) == 0
    capsys.readouterr()
    assert main(["lots", "--database", address, "--json"]) == 0
    known = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [one["name"] for one in known if one["vehicle"] == "fast1"] == ["fluid lot"]


def test_a_population_of_a_newer_program_is_an_error(tmp_path: Path) -> None:
    engine = open_database(f"sqlite:///{tmp_path / 'newer.sqlite'}")
    migrate(engine)
    with sqlite3.connect(tmp_path / "newer.sqlite") as connection:
        connection.execute("INSERT INTO population VALUES (1, '2026-01-01 00:00:00', 0, '{\"schema\": \"v9\"}')")
    connection.close()
    with pytest.raises(DatabaseError, match="cannot be used"):
        latest(engine)
    engine.dispose()


def test_a_fleet_of_one_teaches_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    address = f"sqlite:///{tmp_path / 'small.sqlite'}"
    engine = open_database(address)
    migrate(engine)
    Writer(engine).store(Batch(shifts=[row_of(one) for one in (*history(40), fleet_result(1, vehicle="other"))]))
    engine.dispose()
    assert main(["peers", "--database", address, "--keep"]) == 0
    text = capsys.readouterr().out
    assert "learned from 3 clutches; 1 of another calibration are left out" in text
    assert "Lots" not in text
    assert "aster than" not in text
    assert text.endswith("kept as population 1\n")
    assert main(["lots", "--database", address]) == 0
    assert "Properties of 0 vehicles" in capsys.readouterr().out


def test_people_read_which_lots_are_bad() -> None:
    record = {"name": "fluid lot", "loss_ratio_log_std": 0.1, "vehicle_count": 9}
    bad = record | {"value": "B7", "loss_ratio": 1.92, "e_value": 5.0e4, "is_faster_than_others": True}
    good = record | {"value": "B8", "loss_ratio": 0.98, "e_value": 0.02, "is_faster_than_others": False}
    text = StringIO()
    show(lot_standings_table([bad, good]), text, None)
    assert "Lots that age faster than the others: 1 of 2" in text.getvalue()
    lines = [line.split() for line in text.getvalue().splitlines()]
    assert ["fluid", "lot", "B7", "yes", "9", "1.92", "20", "5e+04"] in lines


def test_either_database_keeps_lots_and_populations(engine: Engine) -> None:
    now = datetime.now(UTC)
    rows = [
        LotRow(vehicle=f"car{car}", name=name, value=value)
        for car in range(600)  # more than one statement takes
        for name, value in (("plant", "north"), ("built", ""))
    ]
    done = store_lots(engine, rows, at=now, by="anna")
    assert (done.vehicle_count, done.lot_count, done.unheard_count) == (600, 600, 600)
    store_lots(engine, [LotRow(vehicle="car1", name="plant", value="")], at=now, by="anna")
    assert len(lots_of(engine)) == 599
    nothing = Population(life_count=0, peers=())
    assert latest(engine) is None
    assert [keep(engine, nothing, 3, at=now, by="anna") for _ in range(2)] == [1, 2]
    kept = latest(engine)
    assert kept is not None
    assert (kept.version, kept.population.version, kept.learned_at) == (2, 2, now)
