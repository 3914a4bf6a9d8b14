"""Which vehicles can be judged at all: a folder of logs of many kinds, a row for each, right in each row."""

import csv
import gzip
import io
import json
import shlex
import signal
import subprocess
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import numpy as np
import psutil
import pytest

import diag_service
from canlog.database.loading import load_database
from diag_service.diagnosis.columns import Signal
from diag_service.errors import StoppedError
from diag_service.mapping.profile import load_shipped
from diag_service.stopping import Trigger
from ecu_emulator.cli import main as emulator
from ecu_emulator.log_formats import open_log
from studies.builders import written
from studies.converter_car import ConverterCar, drive
from studies.scan_tool import COLUMNS, of_automatic
from tests.integration.test_lockup_table import write_automatic
from tests.support.foreign_databases import write_database
from tests.support.in_process import command, ended, workers_here
from tests.support.patience import HANG_S
from tests.support.recode import Drive, drive_of, recoded, write_candump
from tests.support.service import PROGRAM, environment
from tests.support.traffic import START_NS, random_frames

SPEEDS = frozenset({"Engine Speed", "Vehicle Speed"})
STANDING = frozenset({Signal.INPUT_SPEED, Signal.CURRENT_GEAR})  # sent, and 0 throughout
Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """What a row must say; texts are parts of what it says."""

    kind: str
    tier: int | None = None
    tells: str = ""
    missing: str = ""
    remark: str = ""


OURS = Expected(kind="frames of dct.dbc, profile dct", tier=1, tells="friction")
HYUNDAI = Expected(
    kind="frames of hyundai.dbc, profile hyundai_dct", tier=2, tells="torque capacity", missing="clutch 1 pressure"
)
FOREIGN = Expected(kind="frames of a bus that no database here knows", tells="nothing", missing="database of its bus")
NO_LOG = Expected(kind="no log")
EXPECTED = {
    "ours/drive.log": OURS,
    "ours/drive.asc": OURS,
    "ours/drive.blf": OURS,
    "ours/drive.log.gz": OURS,
    "ours/half.blf": Expected(kind="blf, frames of dct.dbc", tier=1, remark="cut off"),
    "ours/lockup.log": Expected(
        kind="frames of lockup.dbc, profile lockup", tier=1, tells="friction of the lock-up clutch"
    ),
    "ours/wrong-checksums.log": Expected(kind="no database here knows", remark="frames were refused ("),
    "hyundai/drive.log": HYUNDAI,
    "hyundai/again.log": HYUNDAI,
    "hyundai/still.log": Expected(
        kind="profile hyundai_dct",
        tier=3,
        tells="shift time and slip",
        missing="torque capacity needs input shaft speed",
        remark="TCU11.N_TC is 0 throughout: taken as absent",
    ),
    "vw/drive.log": Expected(
        kind="frames of vw.dbc, profile vw_mqb", tier=2, tells="torque capacity", remark="vw_mqbevo would read the same"
    ),
    "tables/friction.csv": Expected(kind="table of signals", tier=1, tells="friction"),
    "tables/lockup.csv": Expected(
        kind="table of signals", tier=2, tells="slope of friction of the lock-up", missing="pressure as measured"
    ),
    "tables/speeds.csv": Expected(kind="table of signals", tells="nothing", missing="shift time and slip need"),
    "tables/speeds-and-gears.csv": Expected(kind="table of signals", tier=3, missing="torque capacity needs"),
    "others/random.log": FOREIGN,
    "others/random.blf": FOREIGN,
    "others/notes.txt": NO_LOG,
    "others/empty.log": NO_LOG,
    "others/torn.log.gz": NO_LOG,
}


@pytest.fixture(name="cars", scope="module")
def _cars(cycle_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of vehicles, each with its logs, and beside it the databases of two of them."""
    cars = tmp_path_factory.mktemp("many") / "cars"
    for folder in {Path(name).parent for name in EXPECTED}:
        (cars / folder).mkdir(parents=True)
    _fill_ours(cars / "ours", cycle_log)
    drive_here = drive_of(cycle_log)
    still: Drive = {key: told for key, told in drive_here.items() if key not in STANDING}
    _fill_foreign(cars / "hyundai", "hyundai_dct", {"drive": drive_here, "again": drive_here, "still": still})
    _fill_foreign(cars / "vw", "vw_mqb", {"drive": drive_here})
    _fill_tables(cars / "tables", cycle_log)
    for name in ("random.log", "random.blf"):
        with open_log(cars / "others" / name, start_ns=START_NS) as log:
            log.write(random_frames(5_000))
    (cars / "others" / "notes.txt").write_text("What was measured on the third day", encoding="utf-8")
    (cars / "others" / "empty.log").touch()
    (cars / "others" / "torn.log.gz").write_bytes(gzip.compress(cycle_log.read_bytes())[:30])
    return cars


def _fill_ours(folder: Path, cycle_log: Path) -> None:
    data = cycle_log.read_bytes()
    (folder / "drive.log").write_bytes(data)
    (folder / "drive.log.gz").write_bytes(gzip.compress(data, 1))
    with can.ASCWriter(folder / "drive.asc") as asc, can.BLFWriter(folder / "drive.blf") as blf:
        for message in can.CanutilsLogReader(folder / "drive.log"):
            asc.on_message_received(message)
            blf.on_message_received(message)
    whole = (folder / "drive.blf").read_bytes()
    (folder / "half.blf").write_bytes(whole[: len(whole) // 2])
    assert emulator(["record", str(folder / "lockup.log"), "--scenario", "lockup"]) == 0
    (folder / "lockup.log.truth.jsonl").unlink()
    # The last byte of each frame is another one: every frame with a checksum is refused.
    wrong = [line[:-1] + (b"0" if line[-1:] != b"0" else b"1") for line in data.splitlines()]
    (folder / "wrong-checksums.log").write_bytes(b"\n".join(wrong) + b"\n")


def _fill_foreign(folder: Path, profile_name: str, drives: Mapping[str, Drive]) -> None:
    database, profile = folder.parents[1] / f"{folder.name}.dbc", load_shipped(profile_name)
    write_database(profile, database)
    for name, columns in drives.items():
        write_candump(folder / f"{name}.log", recoded(columns, load_database(database), profile))


def _fill_tables(folder: Path, cycle_log: Path) -> None:
    rng = np.random.default_rng(3)
    written(cycle_log, folder / "friction.csv", rng, left_out=frozenset[str]())
    written(cycle_log, folder / "speeds.csv", rng, left_out=frozenset(COLUMNS) - SPEEDS)
    gears = {"Current Gear", "Target Gear"}
    written(cycle_log, folder / "speeds-and-gears.csv", rng, left_out=frozenset(COLUMNS) - SPEEDS - gears)
    write_automatic(folder / "lockup.csv", of_automatic(drive(ConverterCar(followed_ratio=1.0), rng, 4.0).columns, rng))


def words_for(cars: Path, *more: str) -> list[str]:
    return [
        "signals",
        str(cars),
        "--dbc",
        str(cars.parent / "vw.dbc"),
        "--dbc",
        str(cars.parent / "hyundai.dbc"),
        *more,
    ]


@pytest.fixture(name="rows", scope="module")
def _rows(cars: Path) -> dict[str, Row]:
    run = ended(*words_for(cars, "--json", "--vehicle-from", "path", "--jobs", "1"))
    assert run.status == 0, run.err
    return {str(Path(row["path"]).relative_to(cars)): row for row in run.records}


@pytest.mark.parametrize("name", EXPECTED)
def test_each_row_is_right(rows: Mapping[str, Row], name: str) -> None:
    row, expected = rows[name], EXPECTED[name]
    assert row["schema"] == "clutchdiag/reach/v1"
    assert row["tier"] == expected.tier, row
    assert row["vehicle"] == name.partition("/")[0]
    for part in ("kind", "tells", "missing"):
        assert getattr(expected, part) in row[part]
    assert expected.remark in "; ".join(row["remarks"])
    if expected.tier == 1 or expected.kind == "no log":
        assert row["missing"] == ""
    if expected.kind == "no log":
        assert row["remarks"]
        assert row["next_step"] == ""
    else:
        assert row["next_step"].startswith("diag-service ")


def test_there_is_one_row_for_each_file(rows: Mapping[str, Row], cars: Path) -> None:
    assert sorted(rows) == sorted(EXPECTED)
    assert len(rows) == sum(path.is_file() for path in cars.rglob("*")) == 20


@pytest.mark.parametrize(
    "name", ["ours/drive.asc", "ours/lockup.log", "hyundai/drive.log", "vw/drive.log", "tables/lockup.csv"]
)
def test_the_next_step_is_a_command_that_reaches_what_the_row_says(rows: Mapping[str, Row], name: str) -> None:
    program, *words = shlex.split(rows[name]["next_step"], comments=True)
    assert program == "diag-service"
    run = ended(*words, "--json")
    assert run.status == 0, run.err
    assert run.summary["capability"]["tier"] == rows[name]["tier"]


def test_the_rows_as_csv_are_those_as_json(rows: Mapping[str, Row], cars: Path) -> None:
    run = ended(*words_for(cars, "--csv", "--vehicle-from", "path", "--jobs", "1"))
    table = list(csv.DictReader(io.StringIO(run.out)))
    assert [Path(row["path"]).relative_to(cars).as_posix() for row in table] == list(rows)
    for row, record in zip(table, rows.values(), strict=True):
        assert row["tier"] == ("" if record["tier"] is None else str(record["tier"]))
        assert row["next_step"] == record["next_step"]
        assert row["signals"] == "; ".join(record["signals"])


def test_people_get_each_log_with_what_is_missing_and_the_best_of_each_vehicle(cars: Path) -> None:
    run = ended(*words_for(cars, "--vehicle-from", "path", "--jobs", "1"))
    assert (
        f"{cars}/ours/drive.log: tier 1, friction\n    candump, frames of dct.dbc, profile dct\n    next: diag-"
        in run.out
    )
    assert "vehicle hyundai: tier 2, torque capacity, by again.log of 3 logs\n" in run.out
    assert "vehicle others: no tier, tells nothing, by " in run.out
    last = run.out.splitlines()[-1]
    assert last == "17 logs: 7 of tier 1, 4 of tier 2, 2 of tier 3, 4 of no tier; 3 other files"


def test_without_their_databases_foreign_buses_are_told_so(cars: Path) -> None:
    run = ended("signals", cars / "hyundai", "--json", "--jobs", "1")
    assert {row["tier"] for row in run.records} == {None}
    assert all("--dbc FILE" in row["next_step"] for row in run.records)


def test_a_database_that_no_shipped_profile_knows_is_read_with_the_profile_that_signals_proposes(
    cycle_log: Path, tmp_path: Path
) -> None:
    profile, database, log = load_shipped("vw_mqb"), tmp_path / "car.dbc", tmp_path / "drive.log"
    write_database(profile, tmp_path / "vw.dbc")
    write_candump(log, recoded(drive_of(cycle_log), load_database(tmp_path / "vw.dbc"), profile))
    renamed = (tmp_path / "vw.dbc").read_text(encoding="utf-8").replace("Getriebe_", "TCU_").replace("Motor_", "ECU_")
    for name, plain in (
        ("MO_Drehzahl_01", "EngineSpeed"),
        ("GE_Zielgang", "TargetGear"),
        ("GE_Eingangsdrehz", "InputSpeed"),
    ):
        renamed = renamed.replace(name, plain)
    database.write_text(renamed, encoding="utf-8")
    (row,) = ended("signals", log, "--dbc", database, "--json").records
    assert "proposed profile" in row["kind"]
    text = ended("signals", log, "--dbc", database).out
    assert f"As it stands it reaches tier {row['tier']} " in text
    assert "> car.toml" in row["next_step"]


def test_python_gets_the_same_rows(rows: Mapping[str, Row], cars: Path) -> None:
    databases = [cars.parent / "vw.dbc", cars.parent / "hyundai.dbc"]
    with workers_here():
        found = diag_service.survey_logs(cars, databases, jobs=1, has_vehicles=True)
    assert [json.loads(json.dumps(row.to_record())) for row in found] == list(rows.values())


def test_a_folder_without_a_log_shows_why_and_fails(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("nothing", encoding="utf-8")
    run = ended("signals", tmp_path)
    assert run.status == 3
    assert "notes.txt: not read" in run.out
    assert "none of 1 files is a log that can be read, for one notes.txt: not a log of a known format" in run.err


def test_one_profile_is_not_proposed_for_two_databases(drive_log: Path, cars: Path) -> None:
    run = ended("signals", drive_log, *words_for(cars)[2:])
    run.assert_one_line(2, "a profile is proposed for one log and one database")


def test_a_run_that_is_stopped_shows_what_was_looked_into(cars: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stop = Trigger()
    stop.set()
    with pytest.raises(StoppedError, match="stopped early: 0 of 17 logs were looked into"):
        command("signals", cars, "--jobs", "1", stop=stop)
    assert "notes.txt: not read" in capsys.readouterr().out


def test_ctrl_c_ends_it_with_its_status(drive_log: Path, tmp_path: Path) -> None:
    for number in range(200):
        (tmp_path / f"{number:03}.log").write_bytes(drive_log.read_bytes())
    with subprocess.Popen(
        [*PROGRAM, "signals", str(tmp_path), "--jobs", "1", "-v"], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env=environment(), text=True,
    ) as process:  # fmt: skip
        children_began = _wait_for_child(process.pid)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=HANG_S)
    assert children_began
    assert process.returncode == 130
    assert "of 200 logs were looked into" in err


def _wait_for_child(pid: int) -> bool:
    end_s = time.monotonic() + HANG_S
    while time.monotonic() < end_s:
        if psutil.Process(pid).children():
            return True
        time.sleep(0.05)
    return False
