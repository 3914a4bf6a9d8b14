"""Folders of logs: many drives by several processes, resumable, in one table."""

import csv
import json
from pathlib import Path

import pyarrow.parquet as pq

from diag_service.batch.tables import Entry, write_results
from tests.plugins.drives import SHIFT_COUNT
from tests.support.folders import fill_folder, kill_and_resume
from tests.support.in_process import ended as run

LOG_COUNT = 4


def test_a_run_that_was_killed_goes_on_where_it_ended(drive_log: Path, tmp_path: Path) -> None:
    paths = fill_folder(tmp_path / "logs", drive_log, LOG_COUNT)
    killed = kill_and_resume(tmp_path / "logs", tmp_path / "out.jsonl", jobs=2, kill_after=1)
    assert 1 <= killed.done_before < LOG_COUNT
    assert killed.outlived == 0
    assert killed.files == {str(path): 1 for path in paths}
    assert len(killed.shift_keys) == killed.shift_keys.total() == LOG_COUNT * SHIFT_COUNT
    assert f"{killed.done_before} of {LOG_COUNT} drives were done before" in killed.second_stderr


def test_the_tables_hold_what_a_drive_gives(drive_log: Path, tmp_path: Path) -> None:
    plain = run("analyze", drive_log, "--json")
    ended = run("analyze", drive_log, "-o", tmp_path / "out.jsonl", "--jobs", "1")
    assert ended.status == 0, ended.err
    assert f"{SHIFT_COUNT} shifts of 1 drives in {tmp_path / 'out.jsonl'}" in ended.err
    *shifts, drive = (json.loads(line) for line in (tmp_path / "out.jsonl").read_text(encoding="utf-8").splitlines())
    assert shifts == plain.shifts
    assert drive["summary"] == plain.summary
    entry = Entry(key="", drive=drive, shifts=tuple(shifts))
    write_results(tmp_path / "out.csv", [entry])
    write_results(tmp_path / "out.parquet", [entry])
    with (tmp_path / "out.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    table = pq.read_table(tmp_path / "out.parquet").to_pylist()
    for row, typed, shift in zip(rows, table, plain.shifts, strict=True):
        assert float(row["friction.mu_c"]) == typed["friction.mu_c"] == shift["friction"]["mu_c"]
        assert int(row["to_gear"]) == typed["to_gear"] == shift["to_gear"]
        assert row["verdict.condition"] == typed["verdict.condition"] == shift["verdict"]["condition"]


def test_what_cannot_be_read_and_what_is_left_out_is_told_and_stops_nothing(drive_log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    fill_folder(folder, drive_log, 1)
    (folder / "bad.blf").write_bytes(b"LOGG" + bytes(200))
    notes = folder / "notes.txt"
    notes.write_bytes(b"what we measured\n" * 900 + b"  1)     1841 0001 8 00 11 22 33 44 55 66 77\n")
    (folder / "trip.zip").write_bytes(b"PK\x03\x04" + bytes(90))
    ended = run("analyze", folder, "--jobs", "1")
    assert ended.status == 0
    assert f"{folder / 'bad.blf'}: not read: " in ended.out
    assert f"2 drives, {SHIFT_COUNT} shifts, 1 could not be read, 2 files left out" in ended.out
    assert f"left out: {notes}: not a log of a known format" in ended.err
    assert f"left out: {folder / 'trip.zip'}: a zip archive: unpack it first" in ended.err
    ended = run("analyze", folder, "--jobs", "1", "--json")
    records = [json.loads(line) for line in ended.out.splitlines()]
    left_out = [record for record in records if record["schema"] == "clutchdiag/left-out/v1"]
    assert [(record["path"], bool(record["reason"])) for record in left_out] == [
        (str(notes), True), (str(folder / "trip.zip"), True),
    ]  # fmt: skip


def test_a_folder_below_names_the_vehicle(drive_log: Path, tmp_path: Path) -> None:
    for name in ("car1/monday", "car2"):
        fill_folder(tmp_path / "fleet" / name, drive_log, 1)
    words: list[str | Path] = ["analyze", tmp_path / "fleet", "--jobs", "2", "--vehicle-from", "path"]
    ended = run(*words, "-o", tmp_path / "out.parquet")
    assert ended.status == 0, ended.err
    table = pq.read_table(tmp_path / "out.parquet")
    rows = table.to_pylist()
    assert {(Path(row["path"]).relative_to(tmp_path / "fleet").parts[0], row["vehicle"]) for row in rows} == {
        ("car1", "car1"), ("car2", "car2"),
    }  # fmt: skip
    assert {str(table.schema.field(name).type) for name in ("start_utc", "end_utc", "produced_at")} == {
        "timestamp[ns, tz=UTC]"
    }
    for row in rows:
        assert int(row["start_utc"].timestamp() * 1e6) == row["start_bus_ns"] // 1000
