"""What an earlier program left is taken over: running state, baselines, keys, calibration, outbox, fleet database."""

import json
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import select

from clutch_model.calibration import nominal_calibration, read_calibration
from diag_service.diagnosis.results import dump, shift_record
from diag_service.service.session import resume, versions_for
from diag_service.store import ResultStore
from fleet_backend import queries
from fleet_backend.database import open_database, transaction
from fleet_backend.migrate import make_ready
from fleet_backend.rows import shift_row
from fleet_backend.schema import SHIFT_RESULT
from tests.golden import analyses, earlier
from tests.integration.test_golden_analyses import is_exact

LATER_KEYS = {"kind", "end_reason", "lining", "advice"}
FLEET_HASH = "fbdbd0a37cfbe9c19f8e1258cb6e6405e3ffd5b2fa672e43197c429b84061864"


@pytest.fixture(name="store_path")
def _store_path(tmp_path: Path) -> Path:
    return earlier.database("edge.sql", tmp_path / "edge.sqlite")


def analyze(recording: str, store: Path) -> tuple[str, str]:
    command = [sys.executable, "-m", "diag_service", "analyze", f"{recording}.log.xz", "--vehicle", "car1", "--json"]
    done = subprocess.run(
        [*command, "--store", str(store)], cwd=analyses.RECORDINGS, check=True, capture_output=True, text=True
    )
    return done.stdout, done.stderr


def without_later_keys(line: str) -> str:
    """Return a line of today's output as the earlier program would have written it."""

    def earlier_form(value: object) -> object:
        if isinstance(value, list):
            return [earlier_form(item) for item in value]
        if isinstance(value, dict):
            return {key: earlier_form(item) for key, item in value.items() if key not in LATER_KEYS}
        return value

    record = earlier_form(json.loads(line))
    assert isinstance(record, dict)
    return dump(record) + "\n"


def counts(path: Path) -> tuple[int, int]:
    with closing(ResultStore.open(path)) as store:
        return len(list(store.results("car1"))), store.unpublished_count("car1")


def test_a_vehicle_goes_on_where_the_earlier_program_left_it(store_path: Path) -> None:
    assert counts(store_path) == (43, 37)
    analyze("noise_only", store_path)
    assert counts(store_path) == (43, 37)  # the keys are the same: what is stored is not counted twice
    said, notices = analyze("ideal", store_path)
    assert "afresh" not in notices
    assert json.loads(said.splitlines()[0])["verdict"]["trend"] is not None  # against the baseline of that time
    said = "".join(without_later_keys(line) for line in said.splitlines())
    assert list(analyses.differences(earlier.text("continued.jsonl"), said, is_exact=is_exact())) == []
    assert counts(store_path) == (53, 47)


@pytest.mark.parametrize(("vehicle", "shift_counts"), [("car1", (20, 20)), ("car2", (5, 5))])
def test_running_states_are_those_of_the_calibrations_of_then(
    store_path: Path, vehicle: str, shift_counts: tuple[int, int]
) -> None:
    calibration = nominal_calibration() if vehicle == "car1" else read_calibration(earlier.CALIBRATION)
    with closing(ResultStore.open(store_path)) as store:
        kept = store.state(vehicle)
        state, memory = resume(store, vehicle, versions_for(calibration), calibration)
    assert kept is not None
    assert kept.versions == versions_for(calibration)
    assert state.shift_counts == shift_counts
    assert state.to_json() == kept.filter_state
    assert memory.to_json() == kept.condition
    baselines = kept.filter_state["baselines"]
    assert isinstance(baselines, list)
    assert [one is not None for one in baselines] == [vehicle == "car1"] * 2


def test_the_stream_of_the_live_service_goes_on(store_path: Path) -> None:
    with closing(ResultStore.open(store_path)) as store:
        assert store.stream == "932dcb9e-1137-4094-bfa5-b368d171807a"
        assert store.next_seq() == 4


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
