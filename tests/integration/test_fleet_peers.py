"""What a fleet teaches, from the database to the table: what is usual."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import Engine, select

from clutch_results.pictures import Fan
from clutch_results.prognosis import population_from
from clutch_results.records import ShiftResult
from fleet_backend.ageing.peers import latest_population
from fleet_backend.ageing.prognosis import fan_of_vehicle, read_past
from fleet_backend.cli import main
from fleet_backend.database import open_database, transaction
from fleet_backend.migrate import migrate
from fleet_backend.office_tables import AUDIT
from fleet_backend.page.queries import DatabaseSource
from fleet_backend.writer import Batch, Writer
from tests.support.builders import at
from tests.support.fleet import fleet_result, row_of
from tests.support.histories import history

CARS = 14
FAST = ("fast0", "fast1", "fast2")


def driven(vehicle: str, count: int, stretch: float) -> list[ShiftResult]:
    """Return results over so many times the distance of the usual history, which is a kilometre a result."""
    results = history(count, vehicle=vehicle)
    return [
        replace(one, estimate=at(one.estimate, odometer_m=stretch * (one.estimate.conditions.odometer_m or 0.0)))
        for one in results
    ]


@pytest.fixture(name="fleet", scope="module")
def _fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Store a fleet in which three fluids age three times as fast, and one vehicle has another calibration."""
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


def fan_of_car0(engine: Engine) -> Fan:
    """Return the chart of a vehicle whose second clutch decides."""
    clutches = DatabaseSource(engine).clutches_of(["car0"])
    pasts = [read_past(engine, now, (), 1.5e7, latest_population(engine)) for now in clutches if now.clutch == 2]
    fan = fan_of_vehicle([now for now in clutches if now.clutch == 2], pasts, (), ())
    assert fan is not None
    return fan


def test_what_is_usual_is_learned_kept_and_used(
    address: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    written = tmp_path / "peers.json"
    assert main(["peers", "--database", address, "--json", "--keep", "--write", str(written)]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    usual = [one for one in records if one["record"] == "usual"]
    assert {one["channel"] for one in usual} == {"margin", "level"}
    assert {one["life_count"] for one in usual} == {2 * (CARS + len(FAST))}
    assert {one["record"] for one in records} == {"usual", "population"}
    assert records[-1] == {"record": "population", "version": 1}

    engine = open_database(address)
    kept = latest_population(engine)
    assert kept is not None
    with transaction(engine) as connection:
        audit = connection.execute(select(AUDIT.c.action, AUDIT.c.subject).order_by(AUDIT.c.at)).all()
    assert [tuple(one) for one in audit] == [("keep population", "population 1, from 35 clutches")]
    assert kept == population_from(json.loads(written.read_text(encoding="utf-8")))
    (now,) = (now for now in DatabaseSource(engine).clutches_of(["car0"]) if now.clutch == 2)
    among, alone = (read_past(engine, now, (), 1.5e7, population).prognosis for population in (kept, None))
    chart = fan_of_car0(engine)
    engine.dispose()
    assert among is not None
    assert alone is not None
    assert any("(population 1)" in line for line in among.assumptions)
    assert not any("population" in line for line in alone.assumptions)
    assert among.change_fluid != alone.change_fluid
    reach = among.change_fluid
    assert reach is not None
    assert reach.p50_m is not None
    ends_km = float(np.interp(0.0, -chart.quantiles[1], chart.ahead)) - chart.ahead[0]
    assert ends_km == pytest.approx(reach.p50_m / 1000.0, rel=0.05)  # chart and sentence agree
