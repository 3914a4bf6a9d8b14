"""Tables as programs for owners of cars write them: a clock for each group, a row for each value, no header at all."""

import gzip
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from canlog.arrays import FloatArray
from canlog.database.signal_columns import SignalColumn, column_id
from canlog.errors import CanlogError
from canlog.frames import EXTENDED_FLAG, join
from canlog.logs import read_log, table_columns
from canlog.logs.detection import LogFormat, detect
from canlog.logs.log_counts import LogCounts
from canlog.logs.signal_tables import read_signal_table

Channels = Mapping[SignalColumn, tuple[Sequence[float], Sequence[float]]]  # times [s] and values
SPEED, PRESSURE = SignalColumn("Engine RPM", "/min"), SignalColumn("Clutch 1: pressure", "bar")
OIL = SignalColumn("Transmission oil temperature", "°C")


def drive(count: int = 30) -> Channels:
    """Return three channels of 2.5 Hz, one of them .2 s after the others."""
    at = np.round(0.08 + 0.4 * np.arange(count), 2)
    return {
        SPEED: (at.tolist(), (1000.0 + 7.0 * np.arange(count)).tolist()),
        PRESSURE: (at.tolist(), np.round(2.0 + 0.05 * np.arange(count), 2).tolist()),
        OIL: (np.round(at + 0.2, 2).tolist(), [80.0] * count),
    }


def vcds(channels: Channels, *, has_groups: bool = False) -> str:
    """Return a log of VCDS: of identifiers, or of measuring blocks; each group has a clock of its own."""
    rows = zip(*(zip(*series, strict=True) for series in channels.values()), strict=True)
    body = ["," + ",".join(f"{t:.2f},{value}" for t, value in row) for row in rows]
    if has_groups:
        first, last = zip(*(column.name.rsplit(" ", 1) for column in channels), strict=True)
        head = [
            ",".join(["", *(f"Group {place}:,'0{n}" for n, place in zip(range(len(first)), "ABCDEF", strict=False))]),
            "," + ",".join(f",{name}" for name in first),
            "," + ",".join(f"TIME,{name}" for name in last),
            "Marker," + ",".join(f"STAMP, {column.unit}" for column in channels),
        ]
    else:
        head = [
            "Marker," + "".join(f"TIME,Loc. IDE0{n:04d}," for n, _ in enumerate(channels)),
            "," + "".join(f"STAMP,{column.name}," for column in channels),
            "," + "".join(f", {column.unit}," for column in channels),
        ]
        body = [f"{line}," for line in body]
    before = ["Monday,04,May,2026,16:22:12:40001,Version: Release 24.7.1 (x64)", "02E 300 000 X,ADVMB,DSG  DQ250,", ""]
    return "\n".join([*before, *head, *body, ""])


def car_scanner(channels: Channels) -> str:
    """Return a log with a row for each value, in the order of time, without values where the car told none."""
    values = sorted(
        (t, column.name, value, column.unit)
        for column, series in channels.items()
        for t, value in zip(*series, strict=True)
    )
    rows = [f'"{t + 35000.0:.6f}";"{name}";"{value}";"{unit}";"45.79";"15.72";' for t, name, value, unit in values]
    rows.insert(3, '"35000.200000";"Engine RPM";"";"/min";"45.79";"15.72";')
    return "\r\n".join(['"SECONDS";"PID";"VALUE";"UNITS";"LATITUDE";"LONGTITUDE";', *rows, ""])


def haltech(channels: Channels) -> str:
    """Return an export of NSP: names before the rows, no header over them."""
    kinds = {"/min": "EngineSpeed", "bar": "Pressure", "°C": "Raw"}
    head = [
        line
        for number, column in enumerate(channels)
        for line in (
            f"Channel : {column.name}",
            f"ID : {number}",
            f"Type : {kinds[column.unit]}",
            "DisplayMaxMin : 9,0",
        )
    ]
    times = next(iter(channels.values()))[0]
    values = zip(*(series for _, series in channels.values()), strict=True)
    rows = [f"14:15:{46.0 + t:06.3f},{','.join(map(str, row))}" for t, row in zip(times, values, strict=True)]
    before = ["%DataLog%", "DataLogVersion : 1.1", "DownloadDateTime : 20250718 04:09:48"]
    return "\n".join([*before, *head, "Log Number : 1118", "Log : 20250718 02:15:46", *rows, ""])


def read(text: bytes) -> tuple[dict[str, tuple[FloatArray, FloatArray]], LogCounts, tuple[SignalColumn, ...]]:
    """Return times [s] and values of each column."""
    counts, columns = LogCounts(), detect(text).columns
    batch = join(list(read_signal_table(io.BytesIO(text), counts)))
    assert np.all(np.diff(batch.t_ns) >= 0)
    values = np.ascontiguousarray(batch.data).view("<f8").ravel()
    rows = {one.name: batch.can_id == (column_id(one.name) | EXTENDED_FLAG) for one in columns}
    return {name: (batch.t_ns[one] / 1e9, values[one]) for name, one in rows.items()}, counts, columns


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
@pytest.mark.parametrize("has_groups", [False, True])
def test_each_channel_of_vcds_has_its_own_times(encoding: str, *, has_groups: bool) -> None:
    channels = drive()
    values, counts, columns = read(vcds(channels, has_groups=has_groups).encode(encoding))
    assert columns == tuple(channels)
    assert not counts.rejected
    assert not counts.notes
    for column, (times, expected) in channels.items():
        np.testing.assert_allclose(values[column.name][0], times, atol=1e-6)
        np.testing.assert_array_equal(values[column.name][1], expected)


def test_a_group_that_ends_early_and_a_short_log_are_read() -> None:
    text = vcds(drive(5)).replace(",1.88,80.0,\n", ",,,\n")
    values, counts, _ = read(text.encode())
    assert {name: len(series[0]) for name, series in values.items()} == {SPEED.name: 5, PRESSURE.name: 5, OIL.name: 4}
    assert not counts.rejected


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_a_row_for_each_value_is_a_column_for_each_signal(mark: bytes) -> None:
    channels = drive()
    values, counts, columns = read(mark + car_scanner(channels).encode())
    assert set(columns) == set(channels)
    assert not counts.rejected
    for column, (times, expected) in channels.items():
        np.testing.assert_allclose(values[column.name][0], np.array(times) + 35000.0, atol=1e-6)
        np.testing.assert_array_equal(values[column.name][1], expected)


def test_a_signal_that_comes_late_has_a_column_too(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    text = car_scanner(drive(1000)) + '"35900.1";"TCC slip";"17.5";"rpm";"45.79";"15.72";\r\n'
    path.write_text(text, encoding="utf-8")
    assert SignalColumn("TCC slip", "rpm") in table_columns(path)
    assert len(text) > 2 * 65536


def test_haltech_names_its_channels_before_the_rows_and_dates_them() -> None:
    channels = drive(100)
    values, counts, columns = read(haltech(channels).encode())
    assert columns == (
        SignalColumn(SPEED.name, "rpm"),
        SignalColumn(PRESSURE.name, "0.1 kPa"),
        SignalColumn(OIL.name, ""),
    )
    assert not counts.rejected
    assert values[SPEED.name][1].tolist() == channels[SPEED][1]
    started = values[SPEED.name][0][0] - channels[SPEED][0][0]
    assert started == pytest.approx(np.datetime64("2025-07-18T14:15:46", "s").astype(np.int64), abs=1e-3)


@pytest.mark.parametrize(
    "name", ["MPVI -> AEM 30-(03x0,2340,5130)", "Gear [0,1]", "Slip, wanted", "A|B speed", "Lambda|1"]
)
def test_names_may_hold_separators_that_nobody_quoted(name: str) -> None:
    head = ["HP Tuners CSV Log File", "Version: 1.0", "", "[Channel Information]", "0,4311,99,7"]
    rows = [f"{t / 20:.3f},{1500 + t},{t},4" for t in range(30)]
    text = "\n".join([*head, f"Offset,Engine RPM (SAE),{name},Gear", "s,rpm,rpm,", "", "[Channel Data]", *rows, ""])
    values, counts, columns = read(text.encode())
    assert len(columns) == 3
    assert values[columns[1].name][1].tolist() == list(range(30))
    assert not counts.rejected


@pytest.mark.parametrize("pack", [bytes, gzip.compress])
@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_a_text_in_utf_16_is_read(tmp_path: Path, encoding: str, pack: Callable[[bytes], bytes]) -> None:
    path = tmp_path / "drive.csv"
    path.write_bytes(pack(vcds(drive(2000)).encode(encoding)))
    assert table_columns(path) == tuple(drive())
    with read_log(path) as reader:
        batch = join(list(reader))
        assert len(batch) == 3 * 2000
        assert not reader.counts.rejected
    assert reader.format is LogFormat.SIGNALS


def test_columns_behind_a_later_header_are_found_by_their_names() -> None:
    first = ["Device Time,Speed(km/h),Engine RPM(rpm)", *(f"{t}.0,{t},{900 + t}" for t in range(30, 60))]
    later = ["Device Time,Engine RPM(rpm),Boost(psi),Speed(km/h)", *(f"{t}.0,{900 + t},1,{t}" for t in range(60, 90))]
    values, counts, _ = read("\n".join([*first, *later, ""]).encode())
    assert values["Speed"][1].tolist() == list(range(30, 90))
    assert values["Engine RPM"][1].tolist() == list(range(930, 990))
    assert not counts.rejected
    assert "line 32 begins a recording with columns of its own: Engine RPM, Boost, Speed" in counts.notes


def test_rows_that_are_slower_than_a_bus_are_no_jumps_of_time(tmp_path: Path) -> None:
    path = tmp_path / "slow.csv"
    path.write_text("Time [s],Engine RPM [rpm],Oil [°C]\n" + "".join(f"{5 * t},{900 + t},80\n" for t in range(60)))
    with read_log(path) as reader:
        batch = join(list(reader))
        assert (reader.counts.jumps_ahead, reader.counts.jumps_back, len(batch)) == (0, 0, 120)


def test_a_list_of_networks_may_stand_before_frames(tmp_path: Path) -> None:
    networks = [f"NET {n},Default,NET {n},CAN,500000," for n in range(95)]
    names = "Line,Abs Time(Sec),Rel Time (Sec),Status,Er,Tx,Description,Network,Node,"
    head = [f"{names}{rest}" for rest in ("ID,Cycle,Ch", "Arb ID,Remote,Xtd,B1,B2,B3,B4,Value", "PT,Trgt,Src,B1,B2")]
    rows = [
        f"{n},{n / 100:.6f},0.01,67108868,F,F,,{'MS' if n % 2 else 'HS'} CAN,,CF00400,F,T,F8,7D,{n:02X},10,"
        for n in range(1, 41)
    ]
    path = tmp_path / "bus.csv"
    path.write_text("\n".join(["Vehicle Spy 3 Bus Traffic File", "", *networks, "", *head, *rows, ""]))
    with read_log(path) as reader:
        batch = join(list(reader))
    assert reader.format is LogFormat.COLUMNS
    assert set(batch.can_id.tolist()) == {0x0CF00400 | EXTENDED_FLAG}
    assert batch.data[:, 2].tolist() == list(range(1, 41))
    assert batch.channel.tolist() == [0, 1] * 20


def sparse(channels: Channels) -> str:
    """Return a table with a row for each moment at which one channel or more told a value."""
    moments = sorted({t for times, _ in channels.values() for t in times})
    told = {column: dict(zip(*series, strict=True)) for column, series in channels.items()}
    head = "Time [s];" + ";".join(f"{column.name} [{column.unit}]" for column in channels)
    return "\n".join([head, *(f"{t};" + ";".join(str(told[one].get(t, "")) for one in told) for t in moments), ""])


WRITERS: Mapping[str, Callable[[Channels], str]] = {
    "VCDS": vcds,
    "VCDS with groups": lambda channels: vcds(channels, has_groups=True),
    "Car Scanner": car_scanner,
    "Haltech": haltech,
    "sparse": sparse,
}
COLUMNS = (SPEED, PRESSURE, OIL)
SERIES = st.lists(st.floats(-1e4, 1e4).map(lambda value: round(value, 3)), min_size=25, max_size=60)


@pytest.mark.parametrize("writer", WRITERS)
@settings(max_examples=20, deadline=None)
@given(series=SERIES, late=st.integers(0, 3))
@example(series=[0.0] * 24 + [1.062], late=0)  # other cells show that points stand before decimals
def test_whatever_is_written_is_read(writer: str, series: list[float], late: int) -> None:
    at = np.round(0.4 * np.arange(len(series)), 2)
    channels = {
        column: (np.round(at + 0.1 * late * place, 2).tolist(), [value + place for value in series])
        for place, column in enumerate(COLUMNS)
    }
    values, counts, _ = read(WRITERS[writer](channels).encode())
    assert not counts.rejected
    for column, (_, expected) in channels.items():
        np.testing.assert_allclose(values[column.name][1], expected, rtol=1e-12)


@pytest.mark.parametrize("writer", WRITERS)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damage_costs_values_but_never_more_than_a_sentence(writer: str, tmp_path: Path, data: st.DataObject) -> None:
    text = bytearray(WRITERS[writer](drive()).encode())
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(text) - 1))
        kind = data.draw(st.sampled_from(["cut", "replace", "insert", "line"]))
        if kind == "cut":
            del text[at : at + data.draw(st.integers(1, 200))]
        elif kind == "replace":
            text[at : at + 1] = data.draw(st.binary(min_size=1, max_size=3))
        elif kind == "insert":
            text[at:at] = data.draw(st.sampled_from([b",", b'"', b";", b"\n", b"\r", b"\0", b"1e999", b"TIME", b"-"]))
        else:
            text[at:at] = text[: data.draw(st.integers(0, 400))]
        if not text:
            return
    path = tmp_path / "drive.csv"
    path.write_bytes(text)
    try:
        columns = table_columns(path)
        with read_log(path) as reader:
            known = {column_id(one.name) | EXTENDED_FLAG for one in columns}
            for batch in reader:
                assert np.isfinite(np.ascontiguousarray(batch.data).view("<f8")).all() or not columns
                assert not columns or reader.format is not LogFormat.SIGNALS or set(batch.can_id.tolist()) <= known
    except CanlogError:
        pass
