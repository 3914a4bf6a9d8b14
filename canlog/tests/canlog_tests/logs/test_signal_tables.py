"""Tables of signals: headers of many writers, cells that are none, and what becomes of each value."""

import io

import numpy as np
import pytest

from canlog.database.signal_columns import SignalColumn, column_id
from canlog.errors import SourceError
from canlog.frames import EXTENDED_FLAG, FrameBatch
from canlog.logs.detection import LogFormat, detect
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.signal_tables import read_signal_table, table_header
from tests.support.batches import read_whole

SPEEDS, PRESSURES = [1000.5, 1001.5, 1002.5, 1003.5], [100.0, 105.86, 111.72, 117.58]
TIMES_S = [10.0, 10.037, 10.074, 10.111]
COLUMNS = (SignalColumn("Speed", "rpm"), SignalColumn("Pressure", "kPa"))


def written(head: str, row: str, *, comma: bool = False, times: list[object] | None = None) -> bytes:
    rows = zip(times or TIMES_S, SPEEDS, PRESSURES, strict=True)
    lines = [row.format(*(str(cell).replace(".", ",") if comma else cell for cell in one)) for one in rows]
    return "\n".join([head, *lines, ""]).encode()


WRITERS = {
    "plain": written("Time [s],Speed [rpm],Pressure [kPa]", "{},{},{}"),
    "milliseconds": written(
        "Time (ms),Speed (rpm),Pressure (kPa)", "{},{},{}", times=[round(1e3 * one) for one in TIMES_S]
    ),
    "units row": written("timestamps,Speed,Pressure\ns,rpm,kPa", "{},{},{}"),
    "preamble": written("Recorder 4.2\nsample count;4\nTime;Speed;Pressure\ns;rpm;kPa", "{};{};{}"),
    "german": written("Zeit [s];Speed [rpm];Pressure [kPa]", "{};{};{}", comma=True),
    "tabs and quotes": written('"Time"\t"Speed"\t"Pressure"\n"[s]"\t"[rpm]"\t"[kPa]"', "{}\t{}\t{}"),
    "clock": written("Time,Speed [rpm],Pressure [kPa]", "{},{},{}", times=[f"00:00:{one:06.3f}" for one in TIMES_S]),
    "dates": written(
        "Datum;Speed [rpm];Pressure [kPa]", "{};{};{}", times=[f"01.02.1970 00:00:{one:06.3f}" for one in TIMES_S]
    ),
    "iso": written(
        "DateTime,Speed [rpm],Pressure [kPa]", "{},{},{}", times=[f"1970-02-01T00:00:{one:06.3f}Z" for one in TIMES_S]
    ),
    "index first": written(",t,Speed [rpm],Pressure [kPa],", "7,{},{},{},"),
    "minutes": written(
        "Time [min],Speed [rpm],Pressure [kPa]", "{},{},{}", times=[f"{one / 60:.9f}" for one in TIMES_S]
    ),
    "torque": written(
        "GPS Time, Device Time,Speed [rpm],Pressure [kPa]",
        "Sat Jan 12 CET 2019,{},{},{}",
        times=[f"12-Jan-2019 16:44:{one:06.3f}" for one in TIMES_S],
    ),
    "types before units": written("time\tSpeed\tPressure\nf8\tf8\tf8\ns\trpm\tkPa", "{}\t{}\t{}"),
    "keys and values": written("Date,May\nCar,Golf\nTime [s],Speed [rpm],Pressure [kPa]", "{},{},{}"),
    "padded by Excel": written("Car,Golf,\nLaps,many,\nTime [s],Speed [rpm],Pressure [kPa]", "{},{},{}"),
    "status": written("Time [s],Bits,Speed [rpm],Pressure [kPa]", "{},0x0A,{},{}"),
    "air conditioner": written("Time [s],Mode,Speed [rpm],Pressure [kPa]", "{},AC,{},{}"),
    "windows": written("Time [s],Speed [rpm],Pressure [kPa]", "{},{},{}\r").replace(b"kPa]", b"kPa]\r"),
    "byte-order mark": b"\xef\xbb\xbf" + written("Time [s],Speed [rpm],Pressure [kPa]", "{},{},{}"),
}


def read(text: bytes) -> tuple[FrameBatch, LogCounts]:
    return read_whole(read_signal_table, text)


def values(batch: FrameBatch, name: str) -> list[float]:
    rows = batch.can_id == (column_id(name) | EXTENDED_FLAG)
    found: list[float] = np.ascontiguousarray(batch.data[rows]).view("<f8").ravel().tolist()
    return found


@pytest.mark.parametrize("writer", WRITERS)
def test_tables_of_many_writers_hold_the_same(writer: str) -> None:
    text = WRITERS[writer]
    assert detect(text).format is LogFormat.SIGNALS
    header = table_header(text)
    assert header is not None
    assert header.columns == COLUMNS
    batch, counts = read(text)
    assert values(batch, "Speed") == SPEEDS
    assert values(batch, "Pressure") == PRESSURES
    times_s = np.unique(batch.t_ns) / 1e9
    np.testing.assert_allclose(times_s - times_s[0], np.array(TIMES_S) - TIMES_S[0], atol=1e-6)
    assert not counts.rejected


@pytest.mark.parametrize(
    ("steps", "unit"), [([0.037] * 3, "s"), ([37] * 3, "ms"), ([37_000] * 3, "us"), ([37_000_000] * 3, "ns")]
)
def test_a_unit_of_time_that_nothing_says_is_told_by_its_steps(steps: list[float], unit: str) -> None:
    times = np.cumsum([1000.0, *steps]).tolist()
    batch, counts = read(written("Time,Speed,Pressure", "{},{},{}", times=times))
    assert int(np.median(np.diff(np.unique(batch.t_ns)))) == 37_000_000
    assert [note for note in counts.notes if f"times are taken as {unit}:" in note]


def test_blank_cells_are_no_values_and_bad_ones_are_counted_with_their_place() -> None:
    text = b"Time [s],A,B\n1.0,1,\n1.1,,2\n1.2,nan,oops\n1.3,4,5\n1.4,1e999,6\n1.5,7\nx,8,9\n"
    text += b"".join(b"%d,0,0\n" % second for second in range(2, 12))
    batch, counts = read(text)
    assert values(batch, "A")[:3] == [1.0, 4.0, 0.0]
    assert values(batch, "B")[:4] == [2.0, 5.0, 6.0, 0.0]
    assert counts.rejected == {LogReject.MALFORMED: 4}
    assert counts.first_rejected.startswith("line ")


@pytest.mark.parametrize("end", range(1, 30))
def test_a_table_cut_anywhere_tells_no_value_that_was_not_written(end: int) -> None:
    text = WRITERS["plain"] + b"10.148,1004.25,123.456"
    batch, counts = read(text[:-end] if end < 22 else text[:-22])
    assert set(values(batch, "Speed")) <= {*SPEEDS, 1004.25}
    assert values(batch, "Pressure") == PRESSURES
    assert counts.truncated is (end < 22)


@pytest.mark.parametrize(
    "text",
    [
        b"Time,ID,Length,Data\n1.0,1A2,2,0102\n1.1,1A2,2,0A0B\n1.2,1A2,2,0102\n1.3,1A2,2,0102\n",  # frames
        b"Zeit;Kennung;Inhalt\n1.0;1A2;01 02\n1.1;1A2;0A 0B\n1.2;1A3;01 FF\n1.3;1A2;01 02\n",  # of unusual names
        b"name,grade,year\nann,1,1999\nbob,2,1998\ncid,1,1997\ndan,3,1996\n",  # no times
        b"Time,A\n1,x\n2,y\n3,z\n4,w\n",  # no numbers
        b"just a text\nof some lines\nwithout a table\n",
    ],
)
def test_other_tables_are_not_taken_for_one(text: bytes) -> None:
    assert table_header(text) is None
    with pytest.raises(SourceError):
        list(read_signal_table(io.BytesIO(text), LogCounts()))
