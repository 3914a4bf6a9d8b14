"""A lake in a folder and in an S3 store: every log once, what is there stays, one vehicle can be forgotten."""

import io
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import duckdb
import pyarrow.parquet as pq
import pytest

from clutch_model.calibration import nominal_calibration
from diag_service.errors import IncompleteError, StoreError
from diag_service.lake.parts import DONE, FAILED, Disagreement, LogRow, Manifest, Place, disagreement
from diag_service.lake.run import Job, LakeLog, Maker, find_logs, to_do
from diag_service.settings.config import DiagnosisConfig
from tests.plugins.drives import SHIFT_COUNT
from tests.support.documents import page_text
from tests.support.folders import fill_folder
from tests.support.in_process import command, workers_here
from tests.support.s3 import BUCKET, in_environment, s3_environment, s3_server, store

CONFIG = DiagnosisConfig(vehicle="vehicle", calibration=nominal_calibration())
SIGNALS = "EngineSpeed,*Temperature*"


@pytest.fixture(name="port", scope="module")
def _port() -> Iterator[int]:
    with s3_server() as port, in_environment(s3_environment(port)):
        yield port


@pytest.fixture(name="logs", scope="module")
def _logs(drive_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with logs of two vehicles, the same log twice, and two that are none."""
    folder = tmp_path_factory.mktemp("logs") / "logs"
    fill_folder(folder / "car1", drive_log, 2)
    fill_folder(folder / "car2", drive_log, 1)
    (folder / "car1" / "copy.log").write_bytes((folder / "car1" / "drive000.log").read_bytes())
    (folder / "car2" / "bad.blf").write_bytes(b"LOGG" + bytes(200))
    return folder


def found_in(logs: str | Path, lake_place: Place) -> list[LakeLog]:
    return find_logs([str(logs)], lake_place, "car", has_vehicles=True)


def fill(job: Job, logs: str) -> list[LogRow]:
    """Make what a lake lacks in this process."""
    place, maker = Place(job.lake), Maker(job)
    manifest = Manifest(place)
    missing = to_do(job, found_in(logs, place), manifest, is_retried=False)
    with closing(manifest):
        rows = [maker.make(log) for log in missing]
        for row in rows:
            manifest.note(row)
    manifest.put_together()
    return rows


def shifts_of(address: Path) -> list[tuple[str, int]]:
    shifts = duckdb.read_parquet(f"{address}/shifts/*/*/*.parquet")
    return shifts.aggregate("vehicle, count(*)").order("vehicle").fetchall()


@pytest.fixture(name="filled", scope="module")
def _filled(logs: Path) -> Path:
    """Return a lake that the command has made."""
    place = logs.parent / "lake"
    words = ("--lake", str(place), "--vehicle-from", "path", "--signals", SIGNALS, "--jobs", "1")
    with workers_here():
        command("analyze", str(logs), *words)
    return place


def files_in(place: Path) -> dict[str, int]:
    return {str(path.relative_to(place)): path.stat().st_mtime_ns for path in place.rglob("*") if path.is_file()}


def test_a_part_depends_on_the_content_of_its_log_alone(logs: Path, tmp_path: Path) -> None:
    """Of two logs of one content either may come last."""
    found = {}
    for name in ("drive000.log", "copy.log"):
        job = Job.of(CONFIG, str(tmp_path / name), None, 60.0)
        (log,) = [one for one in found_in(logs, Place(job.lake)) if one.source.endswith(f"car1/{name}")]
        row = Maker(job).make(log)
        found[name] = [(tmp_path / name / part).read_bytes() for part in row.parts]
        (shifts,) = (pq.read_table(tmp_path / name / part) for part in row.parts)
        assert set(shifts["path"].to_pylist()) == {f"sha256:{row.content}"}
    assert found["drive000.log"] == found["copy.log"]


def test_a_lake_is_made_once_and_then_kept(logs: Path, filled: Path, tmp_path: Path) -> None:
    rows = sorted(Manifest(Place(str(filled))).rows, key=lambda row: row.source)
    assert [(str(Path(row.source).relative_to(logs)), row.outcome, row.shifts) for row in rows] == [
        ("car1/copy.log", DONE, SHIFT_COUNT), ("car1/drive000.log", DONE, SHIFT_COUNT),
        ("car1/drive001.log", DONE, SHIFT_COUNT), ("car1/notes.txt", FAILED, 0), ("car2/bad.blf", FAILED, 0),
        ("car2/drive000.log", DONE, SHIFT_COUNT), ("car2/notes.txt", FAILED, 0),
    ]  # fmt: skip
    assert rows[0].parts == rows[1].parts  # one content
    assert shifts_of(filled) == [("car1", 2 * SHIFT_COUNT), ("car2", SHIFT_COUNT)]
    place = Path(shutil.copytree(filled, tmp_path / "lake", copy_function=shutil.copy2))
    before = files_in(place)
    job = Job.of(CONFIG, str(place), SIGNALS, 60.0)
    assert fill(job, str(logs)) == []
    assert files_in(place) == before
    newer = replace(job, settings="of a newer algorithm")
    lake_place = Place(newer.lake)
    missing = to_do(newer, found_in(logs, lake_place), Manifest(lake_place), is_retried=False)
    assert [log.held.size_bytes for log in missing] == sorted((log.held.size_bytes for log in missing), reverse=True)
    with closing(Manifest(lake_place)) as manifest:
        for log in missing:
            if log.source.endswith("drive001.log"):
                maker = Maker(newer)
                maker.__dict__["_analyst"] = Maker(job)._analyst
                manifest.note(maker.make(log))
    after = files_in(place)
    assert len(before.keys() - after.keys()) == 1  # the part of shifts that the newer one replaces
    assert len(after.keys() - before.keys()) == 2  # it, and rows; signals of the log stay
    assert all(after[name] == before[name] for name in before.keys() & after.keys())
    assert shifts_of(place) == [("car1", 2 * SHIFT_COUNT), ("car2", SHIFT_COUNT)]
    assert disagreement(lake_place) == Disagreement(missing=(), unknown=(), twice=())


def test_a_log_that_was_moved_is_in_the_lake_once_whatever_the_version(logs: Path, tmp_path: Path) -> None:
    before, now, address = tmp_path / "before" / "car1", tmp_path / "now" / "car1", tmp_path / "lake"
    before.mkdir(parents=True)
    shutil.copy(logs / "car1" / "drive001.log", before)
    job, place = Job.of(CONFIG, str(address), "EngineSpeed", 60.0), Place(str(address))
    maker = Maker(job)
    first, then = (replace(maker.job, settings=settings) for settings in (job.settings, "of a newer algorithm"))

    def fill_by(job: Job, folder: Path) -> None:
        maker.job = job
        _ = maker._analyst if job is first else None
        with closing(Manifest(place)) as manifest:
            for log in found_in(folder.parent, place):
                manifest.note(maker.make(log))

    fill_by(first, before)
    now.parent.mkdir()
    before.rename(now)
    fill_by(first, now)
    fill_by(then, now)
    assert shifts_of(address) == [("car1", SHIFT_COUNT)]
    assert disagreement(place) == Disagreement(missing=(), unknown=(), twice=())
    rows = Manifest(place).rows
    assert {row.settings for row in rows} == {then.settings}
    assert len({row.parts for row in rows}) == 1
    aside = next(row for row in rows if str(now) not in row.source)
    Manifest(place).add([replace(aside, settings="s", parts=("shifts/date=2026-01-01/vehicle=car1/0.parquet",))])
    (address / "shifts" / "date=2026-01-01" / "vehicle=car1" / "0.parquet").write_bytes(b"PAR1")
    assert len(disagreement(place).twice) == 1
    command("lake", "check", str(address), "--repair")


def test_the_questions_of_page_and_example_have_answers(filled: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(filled.parent)
    (shown,) = re.findall(r"```sql\n(.*?)```", page_text("docs/operations.md"), re.DOTALL)
    views, *questions = re.split(r"^-- .*\?\n", page_text("examples/lake.sql"), flags=re.MULTILINE)
    assert len(questions) == 10
    with duckdb.connect() as lake_engine:
        attention = lake_engine.sql(shown).to_arrow_table().to_pylist()
    with duckdb.connect() as lake_engine:
        lake_engine.execute(views)
        tables = [lake_engine.sql(question).to_arrow_table() for question in questions]
    assert sorted(tables[2].to_pylist(), key=str) == sorted(attention, key=str)  # equal ratios have no order
    answers = [[tuple(row.values()) for row in table.to_pylist()] for table in tables]
    overview, failed, _, trend, _, minutes, _, warm, versions, signals = answers
    assert [(row[0], row[3], row[4]) for row in overview] == [("car1", 2, 2 * SHIFT_COUNT), ("car2", 1, SHIFT_COUNT)]
    assert [Path(row[1]).name for row in failed] == ["notes.txt", "bad.blf", "notes.txt"]
    assert len(trend) == 1
    assert len(minutes) == 2 * SHIFT_COUNT
    assert sum(row[3] for row in warm) > 0
    assert [row[2] for row in versions] == [4]
    assert len(signals) == SHIFT_COUNT
    assert all(row[3] > 500 for row in signals)


def test_one_vehicle_is_forgotten_in_a_store(port: int, logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = store(port)
    files.put(f"{logs}/", f"{BUCKET}/logs", recursive=True)
    address = f"s3://{BUCKET}/lake"
    rows = fill(Job.of(CONFIG, address, None, 60.0), f"s3://{BUCKET}/logs")
    assert sum(row.shifts for row in rows) == 4 * SHIFT_COUNT  # of them one log twice, in one part
    (found,) = files.glob(f"{BUCKET}/lake/shifts/*/vehicle=car2/*.parquet")
    table = pq.ParquetFile(io.BytesIO(files.cat_file(found)))
    assert table.metadata.num_rows == SHIFT_COUNT
    assert table.metadata.row_group(0).column(table.schema_arrow.get_field_index("start_bus_ns")).statistics.has_min_max
    assert fill(Job.of(CONFIG, address, None, 60.0), f"s3://{BUCKET}/logs") == []
    command("lake", "forget", address, "car1", "--json")
    gone = json.loads(capsys.readouterr().out)
    assert (len(gone["parts"]), gone["rows"], gone["shifts"]) == (2, 4, 3 * SHIFT_COUNT)
    assert files.glob(f"{BUCKET}/lake/*/*/vehicle=car1/*") == []
    assert all(b"car1" not in files.cat_file(path) for path in files.glob(f"{BUCKET}/lake/manifest/*"))
    with pytest.raises(StoreError, match="has nothing of car1; it has "):
        command("lake", "forget", address, "car1")
    command("lake", "check", address)
    assert f"3 logs, 2 of them not analysed, {SHIFT_COUNT} shifts of 1 vehicles in 1 parts" in capsys.readouterr().out


def test_what_a_killed_run_left_is_told_and_can_be_removed(logs: Path, filled: Path, tmp_path: Path) -> None:
    address = Path(shutil.copytree(filled, tmp_path / "lake"))
    (part,) = address.glob("shifts/*/vehicle=car2/*.parquet")
    orphan = part.with_name("0-0.parquet")
    orphan.write_bytes(part.read_bytes())
    unfinished = part.with_name(f".{part.name}.1-1.part")
    unfinished.write_bytes(b"PAR1")
    with pytest.raises(IncompleteError, match="disagree"):
        command("lake", "check", str(address))
    command("lake", "check", str(address), "--repair")
    assert not orphan.exists()
    assert not unfinished.exists()
    part.unlink()
    with pytest.raises(IncompleteError, match="--repair, and then another run"):
        command("lake", "check", str(address), "--repair")
    rows = fill(Job.of(CONFIG, str(address), SIGNALS, 60.0), str(logs))
    assert [row.parts for row in rows] == [tuple(one for one in rows[0].parts if "vehicle=car2" in one)]
    command("lake", "check", str(address))


def test_a_log_that_does_not_heed_its_limit_ends_its_worker() -> None:
    # Not at once: the traces are written without the interpreter's lock, and a thread that just begins has none yet.
    program = (
        "import time; from diag_service.lake import run; run.GRACE_S = 0.0\nwith run._limited(0.5): time.sleep(600)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "Timeout" in done.stderr
