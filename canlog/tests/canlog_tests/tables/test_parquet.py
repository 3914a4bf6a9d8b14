"""A log of MF4 becomes Parquet without a compiler, and its numbers without a dictionary."""

import subprocess
import sys
from pathlib import Path

import can
import pyarrow.parquet as pq

DATABASE = """VERSION ""
BU_: A
BO_ 256 Engine: 8 A
 SG_ Speed : 0|16@1+ (0.25,0) [0|16383] "rpm" A
BO_ 2566844926 Wheels: 8 A
 SG_ Speed : 16|16@1+ (0.01,0) [0|600] "km/h" A
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 2566844926 3;
"""
SENT = ((0x100, False, bytes((40, 0, 0, 0, 0, 0, 0, 0))), (0x18FEF100, True, bytes((0, 0, 100, 0, 0, 0, 0, 0))))
WRITE = (
    "import sys, canlog; losses = canlog.write_table('drive.mf4', 'car.dbc', 'drive.parquet');"
    " print(losses, [name for name in ('numba', 'scipy') if name in sys.modules])"
)


def test_mf4_becomes_parquet_without_numba_and_floats_have_no_dictionary(tmp_path: Path) -> None:
    (tmp_path / "car.dbc").write_text(DATABASE, encoding="ascii")
    with can.MF4Writer(tmp_path / "drive.mf4") as log:
        for number, (can_id, is_extended, data) in enumerate(SENT):
            log.on_message_received(can.Message(number, can_id, is_extended_id=is_extended, data=data))
    done = subprocess.run([sys.executable, "-c", WRITE], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert done.stdout == "[] []\n"
    file = pq.ParquetFile(tmp_path / "drive.parquet")
    rows = [{name: row[name] for name in row if "." in name} for row in file.read().to_pylist()]
    assert rows == [{"Engine.Speed": 10.0, "Wheels.Speed": None}, {"Engine.Speed": None, "Wheels.Speed": 1.0}]
    columns = [file.metadata.row_group(0).column(place) for place in range(file.metadata.num_columns)]
    encodings = {column.path_in_schema: column.encodings for column in columns}
    assert not {"RLE_DICTIONARY", "PLAIN_DICTIONARY"} & set(encodings["Engine.Speed"])
    assert "RLE_DICTIONARY" in encodings["message"]
