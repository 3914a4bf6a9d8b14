"""Tables in further ways of writing, each with the columns, units, times and values that a person reads in it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from canlog.arrays import FloatArray
from canlog.errors import SourceError
from canlog_tests.logs.test_tables_of_kinds import COUNT, ROWS, Signals, lines, read

SPEED: FloatArray = np.arange(900.0, 900.0 + COUNT)
PRESSURE: FloatArray = ROWS / 10.0
COUNTED: FloatArray = ROWS.astype(np.float64)
OIL: FloatArray = np.full(COUNT, 80.0, np.float64)
RPM, BAR = ("RPM", "rpm", SPEED), ("Clutch", "bar", PRESSURE)
PLAIN_RPM, PLAIN_BAR = ("RPM", "", SPEED), ("Clutch", "", PRESSURE)
NEAR_S = 1e-6
Expected = Sequence[tuple[str, str, FloatArray]]  # name, unit, values


def rows(pattern: str = "{t:.1f},{rpm},{p:.1f}") -> list[str]:
    return [pattern.format(n=n, t=n / 10.0, rpm=900 + n, p=n / 10.0) for n in range(COUNT)]


HEAD = "Time,RPM,Clutch"
WITH_UNITS = "Time [s]\tRPM [rpm]\tClutch [bar]"
TABBED = rows("{t:.1f}\t{rpm}\t{p:.1f}")
TABLES: dict[str, tuple[str | bytes, Expected]] = {
    "numbers of columns below units": (
        lines('"Time","RPM","Clutch"', '"sec","rpm","bar"', "", '"1","2","3"', "", rows('"{t:.1f}","{rpm}","{p:.1f}"')),
        (RPM, BAR),
    ),
    "numbers of columns, then times from zero": (lines(HEAD, "s,rpm,bar", "1,2,3", rows()), (RPM, BAR)),
    "a first row that counts like columns is one of values": (
        lines("Time,A,B", [f"{1 + n},{2 + n},{3 + n}" for n in range(COUNT)]),
        (("A", "", 2.0 + COUNTED), ("B", "", 3.0 + COUNTED)),
    ),
    "units behind a blank": (
        lines("Time s,Engine Speed rpm,Clutch Pressure bar,Clutch A", rows("{t:.1f},{rpm},{p:.1f},{n}")),
        (("Engine Speed rpm", "rpm", SPEED), ("Clutch Pressure bar", "bar", PRESSURE), ("Clutch A", "", COUNTED)),
    ),
    "an underscore, behind which no unit stands": (
        lines("time_s,engine_speed_rpm,clutch_pressure_bar", rows()),
        (("engine_speed_rpm", "", SPEED), ("clutch_pressure_bar", "", PRESSURE)),
    ),
    "units behind a quoted comma": (
        lines('"Time, s","Engine, rpm","Clutch, bar"', rows()),
        (("Engine, rpm", "rpm", SPEED), ("Clutch, bar", "bar", PRESSURE)),
    ),
    "units behind a stroke": (
        lines("Zeit / s;Drehzahl / 1/min;Druck / bar", rows("{t:.1f};{rpm};{p:.1f}")),
        (("Drehzahl / 1/min", "1/min", SPEED), ("Druck / bar", "bar", PRESSURE)),
    ),
    "letters of clutches are no units": (
        lines("Time,Clutch A,Clutch C", rows()), (("Clutch A", "", SPEED), ("Clutch C", "", PRESSURE)),
    ),
    "units in braces": (lines("Time {s},RPM {rpm},Clutch <bar>", rows()), (RPM, BAR)),
    "brackets within brackets": (
        lines("Time (s),RPM [1/(min)],Flow (mg/stroke (est))", rows()),
        (("RPM", "1/(min)", SPEED), ("Flow", "mg/stroke (est)", PRESSURE)),
    ),
    "signs of minus": (
        lines(HEAD, [f"{n / 10},{900 + n},{'−' if n % 2 else ''}{n}" for n in range(COUNT)]),
        (PLAIN_RPM, ("Clutch", "", np.where(ROWS % 2, -1.0, 1.0) * COUNTED)),
    ),
    "comments between rows": (
        lines("# made by a logger", HEAD, rows()[:5], "# mark, user, 1", rows()[5:20], "// pause, 2", rows()[20:]),
        (PLAIN_RPM, PLAIN_BAR),
    ),
    "a commented header": (lines("#Time,RPM,Clutch", rows()), (PLAIN_RPM, PLAIN_BAR)),
    "lines quoted as a whole": (lines('"Time,RPM,Clutch"', rows('"{t:.1f},{rpm},{p:.1f}"')), (PLAIN_RPM, PLAIN_BAR)),
    "single quotes": (lines("'Time','RPM','Clutch'", rows("'{t:.1f}','{rpm}','{p:.1f}'")), (PLAIN_RPM, PLAIN_BAR)),
    "blanks": (lines("Time RPM Clutch", rows("{t:.1f} {rpm} {p:.1f}")), (PLAIN_RPM, PLAIN_BAR)),
    "columns of blanks": (
        lines("    Time      RPM   Clutch P", rows("{t:8.1f} {rpm:8d} {p:10.1f}")),
        (PLAIN_RPM, ("Clutch P", "", PRESSURE)),
    ),
    "ends of lines of an old Macintosh": (lines(HEAD, rows()).replace("\n", "\r"), (PLAIN_RPM, PLAIN_BAR)),
    "UTF-16 without a mark, not ASCII": (
        lines("Öl [°C]\tTime [s]\tRPM [rpm]", rows("80\t{t:.1f}\t{rpm}")).encode("utf-16-le"),
        (("Öl", "°C", OIL), RPM),
    ),
    "UTF-16 with a mark, Cyrillic": (
        lines("Время\tTime [s]\tRPM [rpm]", rows("80\t{t:.1f}\t{rpm}")).encode("utf-16"),
        (("Время", "", OIL), RPM),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_a_table_is_read_as_a_person_reads_it(tmp_path: Path, name: str) -> None:
    text, expected = TABLES[name]
    signals, counts = read(tmp_path, text)
    check(signals, expected, times_s=1.0 + COUNTED if "counts like columns" in name else PRESSURE)
    assert not counts.rejected


def check(signals: Signals, expected: Expected, times_s: FloatArray) -> None:
    assert [(name, unit) for name, (unit, _, _) in signals.items()] == [(name, unit) for name, unit, _ in expected]
    for name, _, values in expected:
        np.testing.assert_allclose(signals[name][1], times_s, atol=NEAR_S)
        np.testing.assert_allclose(signals[name][2], values, atol=1e-9)


def test_a_mark_of_byte_order_may_stand_where_files_were_joined(tmp_path: Path) -> None:
    part = "\ufeff" + lines(WITH_UNITS, TABBED)
    for text in (part + part, part.encode("utf-16") * 2):
        signals, counts = read(tmp_path, text)
        np.testing.assert_array_equal(signals["RPM"][2], [*SPEED, *SPEED])
        assert not counts.rejected


@pytest.mark.parametrize("blank", ["---", "#N/A", "?", "n.a."])
def test_what_says_that_there_is_no_value_is_no_damage(tmp_path: Path, blank: str) -> None:
    cells = [f"{n / 10},{900 + n},{blank if n % 4 == 0 else n}" for n in range(COUNT)]
    signals, counts = read(tmp_path, lines(HEAD, cells))
    np.testing.assert_array_equal(signals["Clutch"][2], ROWS[ROWS % 4 != 0])
    assert not counts.rejected
    assert not [note for note in counts.notes if "Clutch" in note]


@pytest.mark.parametrize(("first", "then"), [("03/04/2026", "03/05/2026"), ("04/03/2026", "05/03/2026")])
def test_midnight_shows_whether_month_or_day_is_first(tmp_path: Path, first: str, then: str) -> None:
    clock = [f"{first},23:59:{10 + n}" if n < 50 else f"{then},00:00:{n - 50:02d}" for n in range(90)]
    signals, counts = read(tmp_path, lines("Date,Time,RPM", [f"{time},{900 + n}" for n, time in enumerate(clock)]))
    np.testing.assert_allclose(np.diff(signals["RPM"][1]), 1.0)
    assert signals["RPM"][1][0] == pytest.approx(1772668750.0)
    assert not counts.notes


FIRST_RECORDING = lines("Time,RPM,Clutch", "s,rpm,bar", rows())
LATER: dict[str, tuple[str, Expected, str]] = {
    "other columns": (
        lines("Time,Gear,RPM", "s,,rpm", [f"{n / 10},{n % 5},{900 + n}" for n in range(COUNT)]),
        (("Gear", "", COUNTED % 5),), "line 53 begins a recording with columns of its own: Gear, RPM",
    ),
    "other columns, a line before": (
        lines("Recorder,4.2", "Time,Gear,RPM,X", "s,,rpm,", [f"{n / 10},{n % 5},{900 + n},7" for n in range(COUNT)]),
        (("Gear", "", COUNTED % 5), ("X", "", np.full(COUNT, 7.0))),
        "line 54 begins a recording with columns of its own: Gear, RPM, X",
    ),
    "other units": (
        lines("Time,RPM,Clutch", "ms,rpm,kPa", [f"{100 * n},{900 + n},{10 * n}" for n in range(COUNT)]),
        (("Clutch (kPa)", "kPa", 10.0 * COUNTED),),
        "'Clutch' is in kPa in a later recording, not in bar: there it is 'Clutch (kPa)'",
    ),
    "another separator and mark": (
        lines("Zeit;RPM;Gear", "s;rpm;", [f"{n / 10};{900 + n};{n % 5}".replace(".", ",") for n in range(COUNT)]),
        (("Gear", "", COUNTED % 5),), "line 53 begins a recording with columns of its own: RPM, Gear",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LATER)
def test_a_later_recording_may_have_columns_and_units_of_its_own(tmp_path: Path, name: str) -> None:
    text, others, note = LATER[name]
    signals, counts = read(tmp_path, FIRST_RECORDING + text)
    assert list(signals) == ["RPM", "Clutch", *(column for column, _, _ in others)]
    check({column: signals[column] for column, _, _ in others}, others, times_s=PRESSURE)
    np.testing.assert_allclose(signals["RPM"][1], [*PRESSURE, *PRESSURE])
    np.testing.assert_array_equal(signals["RPM"][2], [*SPEED, *SPEED])
    np.testing.assert_allclose(signals["Clutch"][2], PRESSURE)
    assert note in counts.notes
    assert counts.jumps_back == 1
    assert not counts.rejected


@pytest.mark.parametrize("row_count", [30_000, 70_000])
def test_a_later_recording_is_found_wherever_blocks_of_a_file_end(tmp_path: Path, row_count: int) -> None:
    first = lines("Time,RPM,Clutch", [f"{n / 100:.2f},{900 + n % 50},{n % 7}" for n in range(row_count)])
    signals, counts = read(tmp_path, first + lines("Time,RPM,Gear", rows("{t:.1f},{rpm},{n}")))
    assert {name: len(values) for name, (_, _, values) in signals.items()} == {
        "RPM": row_count + COUNT, "Clutch": row_count, "Gear": COUNT,
    }  # fmt: skip
    assert not counts.rejected


def test_recordings_of_vcds_of_other_channels_are_read(tmp_path: Path) -> None:
    head = ["Sunday,15,March,2026,10:22:12:40001,Version: Release 24.7.1", "02E 300 000 X,ADVMB,DSG  DQ250,", ""]
    first = ["Marker,TIME,Loc. IDE1,TIME,Loc. IDE2", ",STAMP,Engine,STAMP,Clutch 1", ",, /min,, bar"]
    then = ["Marker,TIME,Loc. IDE1,TIME,Loc. IDE3,TIME,Loc. IDE4", ",STAMP,Engine,STAMP,Oil,STAMP,Clutch 2"]
    at = [(0.25 + 0.4 * n, 0.45 + 0.4 * n) for n in range(COUNT)]
    one = [f",{a:.2f},{1000 + n},{b:.2f},{n / 10}" for n, (a, b) in enumerate(at)]
    other = [f",{a:.2f},{3000 + n},{b:.2f},{80 + n % 3},{b:.2f},{n / 4}" for n, (a, b) in enumerate(at)]
    text = lines(head, first, one, "", head, then, ",, /min,, °C,, bar", other)
    signals, counts = read(tmp_path, text)
    units = {name: unit for name, (unit, _, _) in signals.items()}
    assert units == {"Engine": "/min", "Clutch 1": "bar", "Oil": "°C", "Clutch 2": "bar"}
    np.testing.assert_array_equal(signals["Engine"][2], [*(1000.0 + ROWS), *(3000.0 + ROWS)])
    np.testing.assert_allclose(signals["Clutch 2"][1], 0.45 + 0.4 * ROWS)
    np.testing.assert_array_equal(signals["Clutch 2"][2], ROWS / 4)
    assert not counts.rejected
    assert counts.jumps_back == 1


@pytest.mark.parametrize("mark", ["# mark, a", "Lap, beacon"])
def test_words_between_rows_are_no_header(tmp_path: Path, mark: str) -> None:
    cells = [f"{n / 10},{900 + n},{n if n % 4 == 0 else ''}" for n in range(COUNT)]
    signals, counts = read(tmp_path, lines(HEAD, cells[:20], mark, cells[20:]))
    assert list(signals) == ["RPM", "Clutch"]
    np.testing.assert_array_equal(signals["RPM"][2], SPEED)
    assert sum(counts.rejected.values()) == (0 if mark.startswith("#") else 1)
    assert not [note for note in counts.notes if "recording" in note]


def test_times_of_day_go_on_behind_another_header(tmp_path: Path) -> None:
    first = lines("Time,RPM", [f"23:59:{n:02d},{n}" for n in range(10, 60)])
    signals, _ = read(tmp_path, first + lines("Time,RPM,Gear", [f"00:00:{n:02d},{n},3" for n in range(50)]))
    np.testing.assert_allclose(np.diff(signals["RPM"][1]), 1.0)


NO_LOGS = {
    "a curve over speed": ("Engine Speed [rpm],Torque [Nm]", [f"{1000 + 50 * n},{200 + n % 7}" for n in range(COUNT)],
                           "no column holds times that rise"),
    "a curve over speed without units": ("RPM,Torque", [f"{1000 + 50 * n},{200 + n % 7}" for n in range(COUNT)],
                                         "no column holds times that rise"),
    "a book of visits": ("Date,Mileage,Cost", [f"2026-{n + 1:02d}-15,{10_000 + 500 * n},{n}" for n in range(12)],
                         "'Date' holds days without times of day"),
    "a database as a table": (
        "Message;Start;Length;Signal;Factor;Offset",
        [f"0x{256 + n // 4:X};{n % 4 * 8};8;Sig{n};0.5;0" for n in range(COUNT)],
        "each row names another thing: a list or catalogue, not a log",
    ),
    "a catalogue of requests": (
        "Name,ModeAndPID,Equation,Units", [f"Speed {n},22{n:04X},A*{n},rpm" for n in range(20)],
        "each row names another thing: a list or catalogue, not a log",
    ),
    "JSON": ("[", [f'{{"time": {n}, "rpm": 900}},' for n in range(20)], "a JSON text"),
    "JSON in lines": ('{"time": 0, "rpm": 900}', [f'{{"time": {n}, "rpm": 900}}' for n in range(20)], "a JSON text"),
    "a part of a page": ("<table>", [f"<tr><td>{n}</td></tr>" for n in range(20)], "an XML or HTML text"),
    "a database without its version": (
        "BU_: A B", [f"BO_ {n + 1} M{n}: 8 A" for n in range(20)], "a message database (DBC): it belongs behind --dbc"
    ),
    "rows without names": ("0.0,899,0.1", rows(), "no line names the columns"),
}  # fmt: skip


@pytest.mark.parametrize("kind", NO_LOGS)
def test_what_is_no_log_is_refused_with_its_cause(tmp_path: Path, kind: str) -> None:
    head, body, why = NO_LOGS[kind]
    with pytest.raises(SourceError) as caught:
        read(tmp_path, lines(head, body))
    assert why in str(caught.value)
