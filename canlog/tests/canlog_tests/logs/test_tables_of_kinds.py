"""Tables that programs and people write in their own ways: columns, units, times and values of each kind."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from canlog.arrays import FloatArray
from canlog.database.signal_columns import column_id
from canlog.errors import SourceError
from canlog.frames import EXTENDED_FLAG, join
from canlog.logs import LogCounts, read_log, table_columns
from canlog.logs.detection import detect

COUNT = 50
ROWS = np.arange(COUNT)
Signals = Mapping[str, tuple[str, FloatArray, FloatArray]]  # unit, times [s], values


def read(folder: Path, text: str | bytes) -> tuple[Signals, LogCounts]:
    path = folder / "drive.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    columns = table_columns(path)
    with read_log(path) as reader:
        batch = join(list(reader))
    values = np.ascontiguousarray(batch.data).view("<f8").ravel()
    rows = {column: batch.can_id == (column_id(column.name) | EXTENDED_FLAG) for column in columns}
    return {one.name: (one.unit, batch.t_ns[at] / 1e9, values[at]) for one, at in rows.items()}, reader.counts


def lines(*parts: str | Sequence[str]) -> str:
    return "\n".join(line for part in parts for line in ([part] if isinstance(part, str) else part)) + "\n"


GROUPS = [
    ",Group A:,'003,,,Group B:,'033,,Group C:, Not Running", ",,Engine,Inj. On,,Clutch,,,",
    ",TIME,Speed,Time,TIME,Pressure,TIME,,",
    "Marker,STAMP, /min, ms,STAMP, bar,STAMP,,",
]  # fmt: skip


def group_rows(speed: float, count: int = COUNT) -> list[str]:
    at = [0.3 + 0.5 * n for n in range(count)]
    return [f",{t:.2f},{speed + n:.0f},{300 + n},{t + 0.2:.2f},{2 + n / 10:.1f},,," for n, t in enumerate(at)]


def test_a_channel_that_is_called_a_time_is_no_clock_of_vcds(tmp_path: Path) -> None:
    signals, counts = read(tmp_path, lines("Friday,03,May,2024,VCDS Version: 23.3.1", GROUPS, group_rows(800)))
    assert {name: unit for name, (unit, _, _) in signals.items()} == {
        "Engine Speed": "/min", "Inj. On Time": "ms", "Clutch Pressure": "bar",
    }  # fmt: skip
    np.testing.assert_allclose(signals["Inj. On Time"][1], 0.3 + 0.5 * ROWS)
    np.testing.assert_allclose(signals["Inj. On Time"][2], 300.0 + ROWS)
    np.testing.assert_allclose(signals["Clutch Pressure"][1], 0.5 + 0.5 * ROWS)
    assert not counts.rejected


@pytest.mark.parametrize("end", ["", ",,,,"])
def test_vcds_in_german_has_a_word_of_its_own_for_stamp(tmp_path: Path, end: str) -> None:
    head = ["Markierung,Zeit,Loc. 21,Zeit,Loc. 22", ",MARKE,Motordrehzahl,MARKE,Öltemperatur", ",, /min,,°C"]
    rows = [f",{0.05 + 0.2 * n:.2f},{1500 + n},{0.1 + 0.2 * n:.2f},80" for n in range(COUNT)]
    text = lines("Montag,04,Mai,2026,VCDS Version: DRV 25.3.1", [line + end for line in (*head, *rows)])
    signals, counts = read(tmp_path, text.encode("cp1252"))
    assert {name: unit for name, (unit, _, _) in signals.items()} == {"Motordrehzahl": "/min", "Öltemperatur": "°C"}
    np.testing.assert_allclose(signals["Öltemperatur"][1], 0.1 + 0.2 * ROWS)
    assert not counts.rejected


@pytest.mark.parametrize("head", [GROUPS, []])
def test_two_recordings_in_a_file_are_not_mixed(tmp_path: Path, head: list[str]) -> None:
    second = ["Friday,03,May,2024,VCDS Version: 23.3.1", "02E 300 000 X,,DQ250", *head] if head else []
    signals, counts = read(tmp_path, lines(GROUPS, group_rows(1000), second, group_rows(3000)))
    assert signals["Engine Speed"][2].tolist() == [*(1000.0 + ROWS).tolist(), *(3000.0 + ROWS).tolist()]
    assert (counts.jumps_back, counts.jumps_ahead) == (1, 0)
    assert not counts.rejected


def test_thousands_may_be_grouped_behind_semicolons(tmp_path: Path) -> None:
    rows = [f"{n / 10:.1f};{960 + 20 * n:,};{50 + n / 2:.1f}" for n in range(COUNT)]
    signals, _ = read(tmp_path, lines("Time (s);Engine RPM (rpm);Speed (km/h)", rows))
    assert signals["Engine RPM"][2].tolist() == (960.0 + 20.0 * ROWS).tolist()


@pytest.mark.parametrize("has_time_of_day", [True, False])
def test_a_row_number_is_no_time(tmp_path: Path, *, has_time_of_day: bool) -> None:
    day = [f"2026-03-15,22:34:{0.62814 + n / 10:08.5f}," if has_time_of_day else "" for n in range(COUNT)]
    rows = [f"{n + 1},{day[n]}{0.227 + 0.1 * n:.5f},,{900 + n}\r" for n in range(COUNT)]
    names = "LogEntryDate,LogEntryTime," if has_time_of_day else ""
    signals, _ = read(tmp_path, lines(f"LogID,{names}LogEntrySeconds,LogNotes,RPM\r", rows))
    start_s = 1773614040.62814 if has_time_of_day else 0.227
    np.testing.assert_allclose(signals["RPM"][1], start_s + 0.1 * ROWS, atol=2e-5)


SOURCES = ["timestamp,elapsed_time,distance,rpm,oil_temp", "unix time,s,m,rpm,.C", ",,100: gps,200: obd,200: obd"]


def test_units_are_the_row_that_holds_units(tmp_path: Path) -> None:
    rows = [f"{1787220000 + n / 10:.3f},{n / 10:.3f},{2 * n},{900 + n},90.5" for n in range(COUNT)]
    signals, _ = read(tmp_path, lines("Format,3", 'Note,"first line', 'second line"', "", SOURCES, rows))
    assert [unit for unit, _, _ in signals.values()] == ["s", "m", "rpm", ".C"]


def test_a_clock_that_begins_again_after_a_pause_is_no_other_clock(tmp_path: Path) -> None:
    rows = [
        f"{1787220000 + n / 10 + 600 * (n >= 30):.3f},{n % 30 / 10:.3f},{2 * n},{900 + n},90.5" for n in range(COUNT)
    ]
    signals, counts = read(tmp_path, lines(SOURCES, rows))
    assert signals["rpm"][2].tolist() == (900.0 + ROWS).tolist()
    assert (counts.jumps_ahead, counts.jumps_back) == (1, 0)


def test_race_capture_has_name_and_unit_in_a_cell(tmp_path: Path) -> None:
    head = '"Interval"|"ms"|0|0|1,"Utc"|"ms"|0|0|1,"RPM"|"rpm"|0.0|10000.0|25,"OilTemp"|"F"|0.0|300.0|1'
    utc_ms = [1785952676240 + 40 * n if n > 3 else 0 for n in range(COUNT)]
    rows = [f"{400 + 40 * n},{utc_ms[n]},{900 + n},{'' if n % 25 else 180.0}" for n in range(COUNT)]
    signals, counts = read(tmp_path, lines(head, rows))
    assert [(name, unit) for name, (unit, _, _) in signals.items()] == [("Utc", "ms"), ("RPM", "rpm"), ("OilTemp", "F")]
    np.testing.assert_allclose(signals["RPM"][1], 0.4 + 0.04 * ROWS)
    assert not counts.notes


def test_rows_may_end_before_their_empty_cells(tmp_path: Path) -> None:
    rows = [f"{n / 10:.1f},{900 + n}" + (",3" if n % 2 else "") for n in range(COUNT)]
    signals, counts = read(tmp_path, lines("Time (s),Engine RPM,Gear,Note", rows, "5.1,951,4,shifted"))
    assert signals["Engine RPM"][2].tolist() == [*(900.0 + ROWS).tolist(), 951.0]
    assert signals["Gear"][2].tolist() == [3.0] * 25 + [4.0]
    assert "end before their last cells" in counts.notes[0]
    assert not counts.rejected


def test_few_short_rows_are_damage(tmp_path: Path) -> None:
    rows = [f"{n / 10:.1f},{900 + n},3" if n != 7 else "0.7,907" for n in range(COUNT)]
    _, counts = read(tmp_path, lines("Time (s),Engine RPM,Gear", rows))
    assert counts.first_rejected == "line 9 (2 cells, not 3): malformed"


def test_a_header_may_have_a_name_more_than_rows_have_cells(tmp_path: Path) -> None:
    rows = [f"{539.6 + n / 20:.3f},1.008,{900 + n},80" for n in range(COUNT)]
    signals, counts = read(tmp_path, lines("#VIN: W", "Time,Amb (Bar),RPM (1/min),Oil (°C),App 5.26 MAP1.bin", rows))
    assert [(name, unit) for name, (unit, _, _) in signals.items()] == [("Amb", "Bar"), ("RPM", "1/min"), ("Oil", "°C")]
    assert "rows have no cells for the last names in the header: App 5.26 MAP1.bin left out" in counts.notes


def of_twelve_hours(row: int) -> str:
    return f"11:59:{40 + row}.250 AM" if row < 20 else f"12:00:{row - 20:02d}.250 PM"


TIMES = {
    "twelve hours": (of_twelve_hours, 43180.25),
    "month first": (lambda row: f"11/25/2023 2:15:{row:02d} PM", 1700921700.0),
    "spreadsheet": (lambda row: f"{45255.59375 + row / 86400:.9f}", 1700921700.0),
}


@pytest.mark.parametrize("clock", TIMES)
def test_times_as_people_of_other_countries_write_them(tmp_path: Path, clock: str) -> None:
    time, start_s = TIMES[clock]
    signals, _ = read(tmp_path, lines("Date Time,Engine RPM", [f"{time(row)},{900 + row}" for row in range(COUNT)]))
    np.testing.assert_allclose(signals["Engine RPM"][1], start_s + ROWS, atol=1e-3)


def test_units_may_stand_in_the_cells(tmp_path: Path) -> None:
    rows = [f"{n / 10:.1f} s;{900 + n} rpm;{80 + n % 3} °C;{'4 bar' if n != 9 else '60 psi'}" for n in range(COUNT)]
    signals, counts = read(tmp_path, lines("Time;Speed;Oil;Clutch", rows))
    assert [unit for unit, _, _ in signals.values()] == ["rpm", "°C", "bar"]
    assert signals["Speed"][2].tolist() == (900.0 + ROWS).tolist()
    assert counts.first_rejected == "line 11, column 'Clutch': malformed"


def test_a_vbox_names_its_columns_in_a_section(tmp_path: Path) -> None:
    head = [
        "File created on 15/05/2024 at 23:59:58", "", "[header]", "satellites", "time", "velocity knots", "EngineSpeed",
        "", "[channel units]", "rpm", "", "[comments]", "Log Rate (Hz) : 10.00", "", "[column names]",
        "sats time velocity EngineSpeed ", "", "[data]",
    ]  # fmt: skip
    hours = ["2359" if n < 20 else "0000" for n in range(COUNT)]
    rows = [f"008 {hours[n]}{(58 + n / 10) % 60:05.2f} 060.{n:03d} {900 + n} " for n in range(COUNT)]
    signals, counts = read(tmp_path, lines(head, rows))
    assert [unit for unit, _, _ in signals.values()] == ["", "kn", "rpm"]
    np.testing.assert_allclose(signals["EngineSpeed"][1], 1715817598.0 + ROWS / 10, atol=1e-6)
    assert not counts.rejected
    assert "on the day of the file" in counts.notes[0]


NO_LOGS = {
    "trouble codes": ("Code,Text\nP0741,Stuck off\nP0897,Fluid\nU0100,Lost\n", "it lists trouble codes (P0741, P0897"),
    "dated codes": (
        "Date,Code,km\n2026-01-02 10:00,P0741,1000\n2026-01-03 10:00,P0897,1200\n2026-01-05 11:00,U0100,1500\n",
        "it lists trouble codes",
    ),
    "catalogue": (
        "ID,Name,Start,Cycle time\n" + "".join(f"{100 + 7 * n},Speed{n},{8 * n},{10 * n}\n" for n in range(30)),
        "each row names another thing: a list or catalogue, not a log",
    ),
    "rows counted": (
        "Sample,RPM\n" + "".join(f"{n},{900 + n % 7}\n" for n in range(30)),
        "'Sample' only counts the rows, and no other column holds times",
    ),
    "header of other rows": (
        "Time,RPM\n" + "".join(f"{n},{n},{n},{n}\n" for n in range(9)), "line 1 names 2 columns, and rows have 4 cells",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", NO_LOGS)
def test_what_is_no_log_is_refused_with_the_cause(kind: str) -> None:
    text, why = NO_LOGS[kind]
    with pytest.raises(SourceError) as caught:
        detect(text.encode())
    assert why in str(caught.value)


def test_what_each_stage_decided_is_told() -> None:
    text = lines("Zeit;Drehzahl", "s;rpm", [f"{n},5;{900 + n}" for n in range(COUNT)])
    assert detect(text.encode()).evidence == (
        "line 2 is followed by rows of 1 signals: semicolons in 52 of 52 lines; line 1 names the columns, line 2 their"
        " units; commas stand before decimals, as in 0,5; 'Zeit' rises"
    )
