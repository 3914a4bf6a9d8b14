"""``decode`` of several logs, and into every format: the numbers are those of the Parquet table."""

import csv
import json
import math
import re
import shutil
from pathlib import Path
from typing import Any

import cantools
import duckdb
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from diag_service.cli import main
from tests.support.documents import page_text
from tests.support.in_process import ended
from tests.support.pipes import piped

DATABASE = """VERSION ""
BU_: A
BO_ 256 Brake: 4 A
 SG_ Page M : 0|2@1+ (1,0) [0|3] "" A
 SG_ Speed m0 : 8|16@1+ (0.5,-10) [0|100] "km/h" A
 SG_ Lamp m1 : 8|1@1+ (1,0) [0|1] "" A
BO_ 512 Engine: 8 A
 SG_ Load : 0|32@1- (1,0) [0|0] "%" A
 SG_ State : 32|8@1+ (1,0) [0|3] "" A
SIG_VALTYPE_ 512 Load : 1;
VAL_ 512 State 1 "on, running" ;
"""
MESSAGES = cantools.database.load_string(DATABASE, "dbc")
LINES = [
    "(1767225600.000001) can0 100#00C80000",
    "(1767225600.001002) can1 200#0000803F01000000",
    "(1767225600.002000) can0 100#01010000",
    "(1767225600.003000) can1 200#0000C07F02000000",  # not a number
    "(1767225600.004000) can0 200#00000040",  # short: no State
]
Row = dict[str, Any]


@pytest.fixture(name="folder")
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with a database and a log, and go there."""
    (tmp_path / "car.dbc").write_text(DATABASE, encoding="utf-8")
    (tmp_path / "drive.log").write_text("".join(f"{line}\n" for line in LINES), encoding="ascii")
    monkeypatch.chdir(tmp_path)
    # Read once: reading a foreign database takes a process of its own.
    for module in ("api.decoding", "settings.options"):
        monkeypatch.setattr(f"diag_service.{module}.open_database", lambda *_, **__: MESSAGES)
    return tmp_path


def decoded(*words: str) -> list[Row]:
    """Return the rows of a Parquet table."""
    told = ended("decode", *words, "--dbc", "car.dbc", "-o", "out.parquet", "--force")
    assert told.status == 0, told.err
    return list(pq.read_table("out.parquet").to_pylist())


def same(one: object, other: object) -> bool:
    both_nan = isinstance(one, float) and isinstance(other, float) and math.isnan(one) and math.isnan(other)
    return both_nan or one == other


def test_a_folder_of_tables_has_one_for_each_message(folder: Path) -> None:
    logs = ("drive.log", "again.log")
    (folder / "again.log").write_text("".join(f"{line}\n" for line in LINES[1:]), encoding="ascii")
    wide = decoded(*logs, "--values", "both")
    for suffix in ("parquet", "arrows", "csv", "jsonl"):
        table_format = suffix.removesuffix("s")
        words = ("decode", *logs, "--dbc", "car.dbc", "--values", "both", "-o", suffix)
        told = ended(*words, "--format", table_format, "--json")
        assert (told.status, told.err) == (0, "")
        record = json.loads(told.out)
        assert record["tables"] == {name: f"{name}.{suffix}" for name in ("Brake", "Engine")}
        assert record["rows"] == len(wide)
        assert {path.name for path in (folder / suffix).iterdir()} == set(record["tables"].values())
    (folder / "parquet").rename(folder / "drive")
    _, query = re.findall(r"```sql\n(.+?)```", page_text("docs/logs.md"), re.DOTALL)
    joined = duckdb.connect().sql(query).project("Speed, State")  # times need a library of zones
    assert joined.fetchall() == [(90.0, None)]
    (folder / "drive").rename(folder / "parquet")
    (folder / "parquet" / "Gone.parquet").write_bytes(b"not ours")
    assert "Brake.parquet is there already" in ended(*words[:-1], "parquet").err
    ended("decode", "drive.log", "--dbc", "car.dbc", "--signals", "Brake.*", "-o", "parquet", "--force")
    assert {path.name for path in (folder / "parquet").iterdir()} == {"Brake.parquet", "Gone.parquet"}
    assert "do not go to standard output" in ended("decode", "drive.log", "--layout", "messages", "-o", "-").err


def test_a_pipe_becomes_a_stream(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    more = ["--dbc", "car.dbc"]
    assert main(["decode", "drive.log", "-o", "out.csv", *more]) == 0
    capfdbinary.readouterr()
    with piped(monkeypatch, [(folder / "drive.log").read_bytes()]):
        assert main(["decode", "-", "-o", "-", *more]) == 0
    out, err = capfdbinary.readouterr()
    assert out == (folder / "out.csv").read_bytes()
    assert b"rows in standard output" in err
    assert main(["decode", "drive.log", "-o", "-", "--format", "arrow", *more]) == 0
    out, _ = capfdbinary.readouterr()
    assert pa.ipc.open_stream(out).read_all().num_rows == 5


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_a_part_is_what_the_whole_has_there(folder: Path, suffix: str) -> None:
    whole = decoded("drive.log")
    columns = {"Brake.Speed", "Engine.State"}

    def is_asked(row: Row) -> bool:
        return row["message"] in {"Brake", "Engine"}

    stretch = ["--from", "0.001001", "--to", "2026-01-01T00:00:00.004+00:00"]
    words = ["--signals", "Brake.S*,State", *stretch, "--json"]
    told = ended("decode", "drive.log", *words, "-o", f"part.{suffix}")
    frames = json.loads(told.out)["frames"]
    assert (frames["read"], frames["left_out"]) == (5, 2)
    assert sum(frames.values()) == 2 * frames["read"]
    if suffix == "csv":
        with (folder / "part.csv").open(encoding="utf-8", newline="") as file:
            count = len(list(csv.DictReader(file)))
    else:
        rows = pq.read_table("part.parquet").to_pylist()
        count = len(rows)
        kept = [
            {name: cell for name, cell in row.items() if "." not in name or name in columns}
            for row in whole
            if is_asked(row) and whole[0]["time"] < row["time"] < whole[-1]["time"]
        ]
        assert rows == kept
    assert count == 3


def test_each_log_of_a_folder_is_a_table_of_its_own(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("api.decoding", "settings.options"):
        monkeypatch.setattr(f"diag_service.{module}.open_database", lambda *_, **__: MESSAGES)
    whole = decoded("drive.log")
    (folder / "logs" / "day").mkdir(parents=True)
    (folder / "logs" / "notes.txt").write_text("What was measured", encoding="ascii")
    for place, lines in (("logs/drive.log", LINES), ("logs/day/drive.log", LINES[:2])):
        (folder / place).write_text("".join(f"{line}\n" for line in lines), encoding="ascii")
    (folder / "logs" / "torn.asc").write_text("date Thu Jan 1 00:00:00 2026\nbase hex timestamps absolute\n", "ascii")
    words = ("decode", "logs", "--dbc", "car.dbc", "-o", "tables", "--jobs", "2")
    ended(*words)
    query, _ = re.findall(r"```sql\n(.+?)```", page_text("docs/logs.md"), re.DOTALL)
    assert sorted(duckdb.connect().execute(query).fetchall()) == [
        (f"tables/{name}drive.log/Brake.parquet", 90.0) for name in ("day/", "")
    ]
    shutil.rmtree("tables")
    wide = (*words, "--layout", "wide")
    told = ended(*wide, "--json", "--strict")
    records = {one["path"]: one for one in map(json.loads, told.out.splitlines())}
    assert told.status == 5
    assert records["logs/notes.txt"]["reason"].startswith("not a log of a known format")
    assert records["logs/torn.asc"]["error"].startswith("no CAN frame in this asc log")
    assert [records[f"logs/{name}drive.log"]["rows"] for name in ("", "day/")] == [5, 2]
    assert (folder / "tables" / "drive.log.parquet").read_bytes() == (folder / "out.parquet").read_bytes()
    first = pq.read_table("tables/day/drive.log.parquet").to_pylist()
    assert all(same(one[name], other[name]) for one, other in zip(first, whole, strict=False) for name in one)
    names = sorted(path.name for path in (folder / "tables").rglob("*"))
    assert names == ["day", "drive.log.parquet", "drive.log.parquet"]
    assert "drive.log.parquet is there already" in ended(*wide).err
    assert "--jobs is for folders" in ended("decode", "drive.log", "-o", "b.csv", "--jobs", "2").err
    assert "standard input does not go with them" in ended("decode", "logs", "-", "-o", "tables").err
