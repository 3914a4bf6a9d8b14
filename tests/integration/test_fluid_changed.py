"""New fluid, noted at the vehicle: after few shifts the verdict is about it, and the past stays."""

import lzma
import re
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from clutch_results.records import FluidFill
from diag_service.store import ResultStore
from tests.golden.compare import RECORDINGS
from tests.support.histories import fill_store, history
from tests.support.in_process import ended

LATER_S = 86_400.0  # between the drives
MOST_SHIFTS = 4  # of a clutch until new fluid is called good
_TIME = re.compile(rb"^\((\d+\.\d+)\)", re.MULTILINE)


def recording(name: str, path: Path, *, later_s: float = 0.0) -> Path:
    """Write a stored recording, as it would be had it been made later."""
    text = lzma.decompress((RECORDINGS / f"{name}.log.xz").read_bytes())
    if later_s:
        text = _TIME.sub(lambda found: b"(%.6f)" % (float(found[1]) + later_s), text)
    path.write_bytes(text)
    return path


@pytest.fixture(name="store", scope="module")
def _store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stored(tmp_path_factory.mktemp("fluid"))


def stored(folder: Path) -> Path:
    """Return a store of a drive with aged fluid, a change of the fluid, and a drive with new fluid."""
    path = folder / "car1.sqlite"
    old = ended("analyze", recording("case2", folder / "old.log"), "--store", path, "--vehicle", "car1", "--json")
    assert {shift["verdict"]["condition"] for shift in old.shifts[-2:]} == {"change_fluid"}
    between = old.shifts[-1]["end_utc"]
    noted = ended("fluid-changed", path, "--at", between, "--odometer", "12346", "--product", "DCTF-II")
    assert (noted.status, noted.err) == (0, "")
    assert f"car1: DCTF-II since {between[:16].replace('T', ' ')} UTC; " in noted.out
    new = recording("ideal", folder / "new.log", later_s=LATER_S)
    found = ended("analyze", new, "--store", path, "--vehicle", "car1", "--json")
    assert found.status == 0
    assert "new fluid since" in found.err
    return path


def test_new_fluid_is_good_after_few_shifts_of_the_clutch(store: Path) -> None:
    records = [one for one in ended("history", store, "--json").records if one["record"] == "event"]
    for clutch in (1, 2):
        new = [one for one in records if one["clutch"] == clutch and one["fluid_since"]]
        assert len(new) >= MOST_SHIFTS
        conditions = [one["condition"] for one in new]
        assert "good" in conditions[:MOST_SHIFTS]
        assert "change_fluid" not in conditions
        assert conditions[0] == "no_verdict"


def test_the_past_stays_as_it_was(store: Path) -> None:
    records = [one for one in ended("history", store, "--json").records if one["record"] == "event"]
    old = [one for one in records if not one["fluid_since"]]
    assert len(old) == 10
    assert old[-1]["condition"] == "change_fluid"
    text = ended("history", store).out
    assert "fluid of unknown age" in text
    assert "DCTF-II since" in text


def test_a_log_of_the_old_fluid_that_comes_late_says_nothing_of_the_new(tmp_path: Path) -> None:
    path, late = stored(tmp_path), recording("case2", tmp_path / "late.log", later_s=-0.5 * LATER_S)
    orders = [ended("history", path, "--json").records[-1]["order"]]
    with closing(sqlite3.connect(path)) as connection:
        state = connection.execute("SELECT belief, condition FROM state").fetchall()
        for log in (late, tmp_path / "old.log", late):
            found = ended("analyze", log, "--store", path, "--vehicle", "car1", "--json")
            orders.append(found.records[-1]["order"])
        assert connection.execute("SELECT belief, condition FROM state").fetchall() == state
    assert {*orders, ended("history", path, "--json").records[-1]["order"]} == {orders[0]}
    assert "sound" in orders[0]


def test_a_fill_is_noted_while_a_service_owns_the_store(store: Path) -> None:
    with closing(ResultStore.open(store)) as owned:
        before = owned.fluid_at("car1", "2999-01-01T00:00:00.000000Z")
        assert ended("fluid-changed", store, "--note", "while it runs").status == 0
        after = owned.fluid_at("car1", "2999-01-01T00:00:00.000000Z")
    assert before is not None
    assert after is not None
    assert after.filled_at > before.filled_at
    assert after.note == "while it runs"


def test_a_fill_noted_twice_within_a_day_is_one(tmp_path: Path) -> None:
    path = tmp_path / "car1.sqlite"
    fill_store(path, history(3))
    assert ended("fluid-changed", path, "--at", "2026-02-01T12:00").status == 0
    said = "the fill of car1 at 2026-02-01 12:00 UTC is noted already; --undo takes it back"
    ended("fluid-changed", path, "--at", "2026-02-02T11:00", "--product", "DCTF").assert_one_line(4, said)
    with closing(ResultStore.open(path)) as store:  # what a fleet tells is kept, and read as one
        later = FluidFill(vehicle="car1", filled_at="2026-02-01T18:00:00.000000Z")
        assert store.add_fills([later]) == 1
        assert [one.filled_at for one in store.fills("car1")] == ["2026-02-01T12:00:00.000000Z"]
        assert len(store.all_fills("car1")) == 2
    assert ended("fluid-changed", path, "--undo").status == 0
    assert ended("history", path, "--json").records[-1]["fills"] == []


def test_a_fill_is_taken_back_and_noted_again_at_its_moment(tmp_path: Path) -> None:
    path = tmp_path / "car1.sqlite"
    fill_store(path, history(40))
    before = ended("history", path).out
    assert "Have the fluid changed at the next service." in before
    assert ended("fluid-changed", path, "--at", "2026-02-01").status == 0
    closed = ended("history", path).out
    assert "New fluid since 2026-02-01 00:00 UTC: nothing is known of it yet." in closed
    assert "at the next service" not in closed
    undone = ended("fluid-changed", path, "--undo")
    assert undone.out == "car1: the fill at 2026-02-01 00:00 UTC is taken back\n"
    assert ended("history", path).out == before
    ended("fluid-changed", path, "--undo").assert_one_line(4, "no fill of car1 is noted")
    again = ended("fluid-changed", path, "--at", "2026-02-01", "--product", "DCTF-II")
    assert "DCTF-II since 2026-02-01 00:00 UTC" in again.out
    assert len(ended("history", path, "--json").records[-1]["fills"]) == 1
    undo = ("fluid-changed", path, "--undo", "--at")
    ended(*undo, "2026-02-02T00:00:01").assert_one_line(4, "no fill of car1 is noted at 2026-02-02T00:00:01.000000Z")
    assert ended("fluid-changed", path, "--at", "2026-02-02T12:00").status == 0
    assert "2026-02-01 00:00 UTC is taken back" in ended(*undo, "2026-02-01").out  # the moment that was said
    assert "2026-02-02 12:00 UTC is taken back" in ended(*undo, "2026-02-02").out
