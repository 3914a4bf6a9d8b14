"""A fill travels by whatever connects: programs over a real Mosquitto, a worker, a store and a fleet database."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import httpx
import pytest

from fleet_backend import queries
from fleet_backend.ageing.calibrations import remember
from fleet_backend.ageing.prognosis import outlook_text, read_past
from fleet_backend.ageing.results import fills_of, results_of
from fleet_backend.database import open_database
from fleet_backend.page.queries import DatabaseSource
from tests.integration.test_fluid_changed import LATER_S, recording
from tests.plugins.broker import Mosquitto
from tests.support.fleet_page import ACCESS, headers_of, served
from tests.support.fleet_worker import worker_here
from tests.support.in_process import ended
from tests.support.patience import HANG_S
from tests.support.service import Ended

pytestmark = pytest.mark.broker

FILLED = datetime(2026, 1, 1, 12, tzinfo=UTC)
RESULTS = 20  # of both logs
NEW_BASELINE = "new fluid since 2026-01-01T12:00:00.000000Z: a new baseline begins"


@dataclass(frozen=True, slots=True, kw_only=True)
class World:
    """A vehicle whose logs are analysed at a workshop, and its fleet."""

    folder: Path
    store: Path
    broker: Mosquitto
    database: str

    def analyze(self, name: str, log: str, *, later_s: float = 0.0, acknowledge: str = "backend") -> Ended:
        path = recording(name, self.folder / log, later_s=later_s)
        words = ("--store", self.store, "--vehicle", "car1", "--broker", self.broker.url, "--acknowledge", acknowledge)
        found = ended("analyze", path, *words, "--json")
        assert found.status == 0, found.err
        return found

    def note_at_the_fleet(self) -> None:
        """Note the fill by the form of the page, as a workshop does."""
        with served(self.database, ACCESS) as address, httpx.Client(base_url=address, trust_env=False) as page:
            words = {"token": ACCESS.token_of("ann"), "product": "DCTF-II", "at": FILLED.strftime("%Y-%m-%dT%H:%M")}
            assert page.post("/vehicles/car1/fluid", headers=headers_of("ann"), data=words).status_code == 303

    def assert_same_everywhere(self) -> None:
        """Check that store and fleet know the same fill, the same order and the same outlook."""
        history = ended("history", self.store, "--json").records
        (noted,) = history[-1]["fills"]
        engine, deadline_s = open_database(self.database), time.monotonic() + HANG_S
        while queries.result_count(engine) < RESULTS:  # a broker's word comes before the worker's
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
        (fill,) = fills_of(engine, "car1")
        clutches = DatabaseSource(engine).clutches_of(["car1"])
        with engine.connect() as connection:
            remember(connection, [("car1", clutches[0].calibration_version)])
        pasts = [read_past(engine, now, fills_of(engine, "car1"), 1.5e7, None) for now in clutches]
        engine.dispose()
        assert fill.filled_at.strftime("%Y-%m-%dT%H:%M:%S.%fZ") == noted["filled_at"]
        assert (fill.product, {one.fluid for one in clutches}) == (noted["product"], {noted["product"]})
        assert {one.order for one in clutches} == {history[-1]["order"]}
        told = ended("history", self.store).out.splitlines()
        assert outlook_text((past.prognosis for past in pasts), clutches[0]) in told


@pytest.fixture(name="world")
def _world(tmp_path: Path, broker: Mosquitto, sqlite_url: str) -> Iterator[World]:
    with worker_here(broker.url, sqlite_url):
        yield World(folder=tmp_path, store=tmp_path / "car1.sqlite", broker=broker, database=sqlite_url)


def test_a_fill_in_the_store_reaches_the_fleet_with_the_next_analysis(world: World) -> None:
    world.analyze("case2", "old.log")
    assert ended("fluid-changed", world.store, "--at", FILLED.isoformat(), "--product", "DCTF-II").status == 0
    world.analyze("ideal", "new.log", later_s=LATER_S)
    world.assert_same_everywhere()


@pytest.mark.parametrize("acknowledge", ["backend", "broker"])
def test_a_fill_at_the_fleet_is_known_before_the_first_shift_of_the_next_analysis(
    world: World, acknowledge: str
) -> None:
    world.analyze("case2", "old.log")
    world.note_at_the_fleet()
    found = world.analyze("ideal", "new.log", later_s=LATER_S, acknowledge=acknowledge)
    assert NEW_BASELINE in found.err
    assert [one["verdict"]["shift_count"] for one in found.shifts[:2]] == [1, 1]
    world.assert_same_everywhere()
    assert ended("report", world.store, "-o", world.folder / "car1.html").status == 0
    assert "DCTF-II" in (world.folder / "car1.html").read_text(encoding="utf-8")


def test_a_fill_that_the_broker_kept_from_before_does_not_stand_for_the_answer_of_the_fleet(world: World) -> None:
    world.analyze("case2", "old.log")
    engine = open_database(world.database)
    queries.note_fill(engine, "car1", "first", at=datetime(2020, 1, 1, tzinfo=UTC), odometer_m=None, note=None)
    engine.dispose()
    world.analyze("case2", "old.log")  # the broker keeps now what the fleet knew
    world.note_at_the_fleet()
    found = world.analyze("ideal", "new.log", later_s=LATER_S)
    assert NEW_BASELINE in found.err


def test_a_fill_that_is_noted_late_leaves_no_verdict_that_rests_on_the_old_fluid(world: World) -> None:
    world.analyze("ideal", "old.log")
    world.analyze("ideal", "new.log", later_s=LATER_S)
    sound = "Nothing to do now"
    assert sound in ended("history", world.store).out
    world.note_at_the_fleet()
    world.analyze("ideal", "old.log")  # has no news of its own, and brings the fill
    told = ended("history", world.store)
    assert "New fluid since 2026-01-01 12:00 UTC: nothing is known of it yet." in told.out
    assert sound not in told.out
    later = [*(row for row in told.out.splitlines() if row.startswith(" DCTF-II since 2026-01-01 12:00"))]
    assert [row.split()[-7:] for row in later] == 2 * [["12:00", "0", "-", "-", "-", "no", "verdict"]]
    world.assert_same_everywhere()
    engine = open_database(world.database)
    rows = [row for row in results_of(engine, "car1", 1) if row["end_at"] > FILLED]
    engine.dispose()
    assert {(row["condition"], row["running_mu_c"], row["level_ratio"]) for row in rows} == {("no_verdict", None, None)}
    events = [one for one in ended("history", world.store, "--json").records if one["record"] == "event"]
    assert {one["running_mu_c"] for one in events if one["fluid_since"]} == {None}
    world.analyze("ideal", "newer.log", later_s=2.0 * LATER_S)
    assert sound in ended("history", world.store).out
