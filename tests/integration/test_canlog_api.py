"""``canlog.read``: frames, arrays and tables of a log, and what is not in them."""

from pathlib import Path

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import canlog
from canlog.tables.layouts import ValuesName

DATABASE = """VERSION ""
BU_: A
BO_ 256 Engine: 8 A
 SG_ Speed : 0|16@1+ (0.25,0) [0|100] "rpm" A
 SG_ State : 56|8@1+ (1,0) [0|0] "" A
BO_ 257 Gear: 2 A
 SG_ Page M : 0|8@1+ (1,0) [0|1] "" A
 SG_ Current m0 : 8|4@1+ (1,0) [0|7] "" A
 SG_ Target m1 : 8|4@1+ (1,0) [0|7] "" A
VAL_ 256 State 0 "idle" 1 "running" ;
VAL_ 256 Speed 65535 "NotAvailable" ;
"""
LOG = """(1.000000) can0 100#0400000000000001
(1.001000) can0 101#0003
(1.002000) can0 100#08000000
(1.003000) can0 101#0104
(1.004000) can0 100#FFFF000000000007
(1.005000) can1 7AB#00
this is no frame
(1.006000) can0 100#R
(1.007000) can0 100#0C00000000000000
(1.008000) can0 00000123##1112233445566778899AABBCC
"""
T_NS = {1: 1_001_000_000, 3: 1_003_000_000}


@pytest.fixture(name="drive")
def _drive(tmp_path: Path) -> Path:
    (tmp_path / "car.dbc").write_text(DATABASE, encoding="ascii")
    (tmp_path / "drive.log").write_text(LOG, encoding="ascii")
    return tmp_path / "drive.log"


@pytest.fixture(name="log")
def _log(drive: Path) -> canlog.Log:
    return canlog.read(drive, drive.with_name("car.dbc"))


def test_the_frames_are_those_of_the_file(log: canlog.Log) -> None:
    assert len(log) == len(log.frames) == 9
    assert log.frames.can_id.tolist()[:4] == [0x100, 0x101, 0x100, 0x101]
    assert log.frames.data[3, :8].tolist() == [1, 4, 0, 0, 0, 0, 0, 0]
    assert log.format is canlog.LogFormat.CANDUMP
    assert repr(log) == f"<canlog.Log {log.path}: candump, 9 frames>"


def test_frames_are_a_table_without_a_database(drive: Path) -> None:
    table = canlog.read(drive).frames_to_arrow()
    *_, remote, _, extended = rows = table.to_pylist()
    assert [row["channel"] for row in rows] == [0] * 5 + [1] + [0] * 3
    assert (rows[0]["data"], remote["data"]) == (bytes.fromhex("0400000000000001"), b"")
    assert extended["data"] == bytes.fromhex("112233445566778899AABBCC")
    kinds = [(row["is_extended"], row["is_fd"], row["is_remote"]) for row in (remote, extended)]
    assert kinds == [(False, False, True), (True, True, False)]
    assert pl.from_arrow(table)["data"].to_list() == table.to_pandas()["data"].tolist()  # type: ignore[index]
    assert np.asarray(table["time"].cast(pa.int64())).tolist()[:2] == [10**9, 10**9 + 1_000_000]


def test_every_frame_and_line_is_accounted_for(log: canlog.Log) -> None:
    assert {reason.value: count for reason, count in log.counts.rejected.items()} == {"malformed": 1}
    assert sum(log.account.fates.values()) == len(log)
    assert {fate.name: count for fate, count in log.account.fates.items() if count} == {
        "DECODED": 5,
        "SHORT": 1,
        "UNKNOWN": 2,
        "REMOTE": 1,
    }
    assert log.losses == [
        "1 pieces of the log are not frames (1 malformed), the first: line 7: malformed",
        "1 frames are shorter than the database says: 1 values are not in them",
    ]


def test_signals_are_arrays_in_the_order_of_the_frames(log: canlog.Log) -> None:
    signals = log.signals()
    assert list(signals) == ["Engine.Speed", "Engine.State", "Gear.Page", "Gear.Current", "Gear.Target"]
    speed = signals["Engine.Speed"]
    assert speed.value.tolist() == pytest.approx([1.0, 2.0, np.nan, 3.0], nan_ok=True)  # one is of a short frame
    assert log.signals(is_raw=True)["Engine.Speed"].value[2] == 16383.75  # a code that says: not available
    assert speed.unit == "rpm"
    assert np.diff(speed.t_ns).tolist() == [2_000_000, 2_000_000, 3_000_000]
    assert signals["Engine.State"].value.tolist() == [1.0, 7.0, 0.0]  # 7 is outside its range, but sent
    assert (signals["Gear.Current"].t_ns.tolist(), signals["Gear.Current"].value.tolist()) == ([T_NS[1]], [3.0])
    assert (signals["Gear.Target"].t_ns.tolist(), signals["Gear.Target"].value.tolist()) == ([T_NS[3]], [4.0])


@pytest.mark.parametrize("values", ["numbers", "texts", "both"])
def test_tables_in_memory_are_those_of_the_file(drive: Path, values: ValuesName) -> None:
    output = drive.with_suffix(".parquet")
    database = canlog.load_database(drive.with_name("car.dbc"))
    log = canlog.read(drive, database)
    assert canlog.write_table(drive, database, output, canlog.TableChoice(values=values)) == log.losses
    table = log.to_arrow("wide", values, is_raw=True)
    assert table.to_pylist() == pl.read_parquet(output).to_dicts()
    assert log.to_polars("wide", values, is_raw=True).to_dicts() == table.to_pylist()
    frame = log.to_pandas("wide", values, is_raw=True)
    pd.testing.assert_frame_equal(frame, pd.read_parquet(output), check_categorical=False)


def test_what_cannot_be_read_is_told(drive: Path) -> None:
    database = drive.with_name("car.dbc")
    with pytest.raises(canlog.SourceError, match=r"none\.log: no such file"):
        canlog.read(drive.with_name("none.log"), database)
    with pytest.raises(canlog.DefinitionError, match="cannot read the database"):
        canlog.read(drive, drive.with_name("none.dbc"))
    with pytest.raises(canlog.SourceError, match="line 7: malformed"):
        canlog.read(drive, database, is_strict=True)
    with pytest.raises(canlog.OutputError, match="cannot write"):
        canlog.write_table(drive, database, drive.with_name("none") / "out.parquet")
    with pytest.raises(ValueError, match="long"):
        canlog.read(drive, database).to_arrow("long")  # type: ignore[arg-type]  # as a user may type it
