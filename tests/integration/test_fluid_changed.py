"""New fluid, noted at the vehicle: after few shifts the verdict is about it, and the past stays."""

import lzma
import re
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from diag_service.store import ResultStore
from tests.golden.analyses import RECORDINGS
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
    """Return a store of a drive with aged fluid, a change of the fluid, and a drive with new fluid."""
    folder = tmp_path_factory.mktemp("fluid")
    path = folder / "car1.sqlite"
    old = ended("analyze", recording("case2", folder / "old.log"), "--store", path, "--vehicle", "car1", "--json")
    assert {shift["verdict"]["condition"] for shift in old.shifts[-2:]} == {"change_fluid"}
    between = old.shifts[-1]["end_utc"]
    noted = ended("fluid-changed", path, "--at", between, "--odometer", "61200", "--product", "DCTF-II")
    assert (noted.status, noted.err) == (0, "")
    assert f"car1: DCTF-II since {between}" in noted.out
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


def test_a_fill_is_noted_once(store: Path) -> None:
    (fills,) = (one for one in ended("history", store, "--json").records if one["record"] == "fills")
    fill = fills["fills"][0]
    assert (fill["odometer_m"], fill["product"]) == (61_200_000.0, "DCTF-II")
    ended("fluid-changed", store, "--at", fill["filled_at"]).assert_one_line(4, "is noted already")


def test_a_fill_is_noted_while_a_service_owns_the_store(store: Path) -> None:
    with closing(ResultStore.open(store)) as owned:
        before = owned.fluid_at("car1", "2999-01-01T00:00:00.000000Z")
        assert ended("fluid-changed", store, "--note", "while it runs").status == 0
        after = owned.fluid_at("car1", "2999-01-01T00:00:00.000000Z")
    assert before is not None
    assert after is not None
    assert after.filled_at > before.filled_at
    assert after.note == "while it runs"


def test_a_store_of_before_knows_no_fill_and_learns_one(tmp_path: Path) -> None:
    path = tmp_path / "car1.sqlite"
    fill_store(path, history(3))
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript("DROP TABLE fill; PRAGMA user_version = 3;")
    assert ended("history", path, "--json").records[-1]["fills"] == []
    assert ended("fluid-changed", path, "--at", "2020-01-01").status == 0
    assert len(ended("history", path, "--json").records[-1]["fills"]) == 1
