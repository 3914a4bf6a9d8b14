"""What a notebook asks a log for: values that are measurements, dense tables, nothing read that was not asked for."""

import math
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pytest

import canlog

DBC = """VERSION ""
BU_: A
BO_ 256 Engine: 4 A
 SG_ Speed : 0|16@1+ (0.25,0) [0|8000] "rpm" A
 SG_ Gear : 16|8@1+ (1,0) [0|3] "" A
BO_ 512 Brake: 1 A
 SG_ Pedal : 0|8@1+ (0.4,0) [0|100] "%" A
VAL_ 256 Speed 65535 "NotAvailable" ;
VAL_ 512 Pedal 255 "not available" ;
"""
LOG = """(1.000000) can0 100#FFFF0100
(1.001000) can1 100#A00F0900
(1.002000) can0 200#FF
(1.003000) can0 200#0A
(1.004000) can0 00000123##1112233445566778899AABBCC
(1.005000) can0 7AB#R
"""


@pytest.fixture(name="drive")
def _drive(tmp_path: Path) -> Path:
    (tmp_path / "car.dbc").write_text(DBC, encoding="utf-8")
    (tmp_path / "drive.log").write_text(LOG, encoding="ascii")
    return tmp_path


def opened(drive: Path) -> canlog.Log:
    return canlog.read(drive / "drive.log", drive / "car.dbc")


def test_codes_that_say_not_available_are_no_values(drive: Path) -> None:
    log = opened(drive)
    speed = log.signals()["Engine.Speed"]
    assert math.isnan(speed.value[0])
    assert speed.value[1] == 1000.0
    assert log.signals()["Engine.Gear"].value.tolist() == [1.0, 9.0]  # outside its range, but sent
    assert log.signals(is_raw=True)["Engine.Speed"].value.tolist() == [16383.75, 1000.0]


def test_frames_are_a_table_without_a_database(drive: Path) -> None:
    table = canlog.read(drive / "drive.log").frames_to_arrow()
    rows = table.to_pylist()
    assert [row["id"] for row in rows] == [0x100, 0x100, 0x200, 0x200, 0x123, 0x7AB]
    assert [row["channel"] for row in rows] == [0, 1, 0, 0, 0, 0]
    assert [row["data"] for row in rows][2:] == [b"\xff", b"\n", bytes.fromhex("112233445566778899AABBCC"), b""]
    assert [(row["is_extended"], row["is_fd"], row["is_remote"]) for row in rows][4:] == [
        (True, True, False),
        (False, False, True),
    ]
    assert pl.from_arrow(table)["data"].to_list() == table.to_pandas()["data"].tolist()  # type: ignore[index]
    assert np.asarray(table["time"].cast(pa.int64())).tolist()[:2] == [10**9, 10**9 + 1_000_000]
