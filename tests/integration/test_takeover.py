"""What an earlier program left is taken over: results, keys, calibration, outbox, fleet database.

Its running states are of another algorithm: vehicles start afresh, and are told.
"""

import contextlib
import json
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import select

from clutch_results.records import ShiftResult, shift_record
from diag_service.store import ResultStore
from fleet_backend import queries
from fleet_backend.database import open_database, transaction
from fleet_backend.migrate import make_ready
from fleet_backend.rows import shift_row
from fleet_backend.schema import SHIFT_RESULT
from tests.golden import compare, earlier
from tests.support.in_process import ended

FLEET_HASH = "fbdbd0a37cfbe9c19f8e1258cb6e6405e3ffd5b2fa672e43197c429b84061864"


@pytest.fixture(name="store_path")
def _store_path(tmp_path: Path) -> Path:
    (tmp_path / "edge.sqlite.lock").write_text("1234\n", "ascii")  # all that the lock of then said
    return earlier.database("edge.sql", tmp_path / "edge.sqlite")


def analyze(recording: str, store: Path) -> tuple[str, str]:
    with contextlib.chdir(compare.RECORDINGS):
        done = ended("analyze", f"{recording}.log.xz", "--vehicle", "car1", "--json", "--store", store)
    assert done.status == 0, done.err
    return done.out, done.err


def counts(path: Path) -> tuple[int, int]:
    with closing(ResultStore.open(path)) as store:
        return len(list(store.results("car1"))), store.unpublished_count("car1")


def results(path: Path) -> list[ShiftResult]:
    with closing(ResultStore.open(path)) as store:
        return list(store.results("car1"))


def test_a_vehicle_starts_afresh_with_a_word_and_keeps_its_results(store_path: Path) -> None:
    assert counts(store_path) == (43, 37)
    earlier_results = results(store_path)
    said, notices = analyze("noise_only", store_path)
    assert "made by algorithm torque-impulse-4" in notices
    assert "starting afresh with a new baseline, results stay" in notices
    first = json.loads(said.splitlines()[0])["verdict"]
    assert (first["shift_count"], first["trend"]) == (1, None)
    assert counts(store_path) == (53, 47)  # what another algorithm says of the same shifts stands beside it
    _, notices = analyze("noise_only", store_path)
    assert "afresh" not in notices  # it was said once
    assert counts(store_path) == (53, 47)  # the keys are the same: what is stored is not counted twice
    assert results(store_path)[:43] == earlier_results


def test_a_fleet_database_keeps_its_results_and_knows_them_again(tmp_path: Path, store_path: Path) -> None:
    engine = open_database(f"sqlite:///{earlier.database('fleet.sql', tmp_path / 'fleet.sqlite')}")
    make_ready(engine)
    assert queries.table_hash(engine) == queries.TableHash(row_count=16, sha256=FLEET_HASH)
    assert [one["reason"] for one in queries.quarantined(engine, 9)] == ["schema"]
    table = SHIFT_RESULT.c
    with transaction(engine) as connection:
        rows = connection.execute(select(table.vehicle, table.stream, table.seq, table.content_digest)).all()
    engine.dispose()
    with closing(ResultStore.open(store_path)) as store:
        stored = [shift_row(shift_record(one)) for vehicle in ("car1", "car2") for one in store.results(vehicle)]
    digests = {(row["vehicle"], row["stream"], row["seq"]): row["content_digest"] for row in stored}
    assert {tuple(row[:3]): row[3] for row in rows}.items() <= digests.items()
