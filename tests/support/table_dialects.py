"""One drive written in every dialect: marks of numbers, rows of the header, clocks, encodings; drawn at random."""

import csv
import io
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Final

from canlog.database.signal_columns import SignalColumn

COLUMNS: Final = (SignalColumn("Engine RPM", "rpm"), SignalColumn("Druck", "bar"), SignalColumn("Öl", "°C"))
START: Final = datetime(2026, 3, 25, 9, 59, 40, tzinfo=UTC)  # a clock of twelve hours reaches ten within a drive


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """Times [ms] since the start, and the values of each channel with its decimals."""

    times_ms: Sequence[int]
    channels: Mapping[SignalColumn, tuple[int, Sequence[float | None]]]


def _clock_12(moment: datetime, fraction: str = ".%f") -> str:
    text = moment.strftime(f"%I:%M:%S{fraction}")
    return f"{text[:-3] if fraction else text} {moment.strftime('%p')}"


def _days(moment: datetime) -> float:
    return (moment - datetime(1899, 12, 30, tzinfo=UTC)) / timedelta(days=1)


def _time(moment: datetime) -> str:
    return moment.strftime("%H:%M:%S.%f")[:-3]


def _american(moment: datetime) -> str:
    return f"{moment.month}/{moment.day}/{moment.year}"


Clock = tuple[tuple[str, ...], Callable[[datetime], tuple[str, ...]]]  # names of its columns, and their cells
CLOCKS: Final[Mapping[str, Clock]] = {
    "seconds": (("Time [s]",), lambda moment: (f"{(moment - START) / timedelta(seconds=1):.3f}",)),
    "bare seconds": (("Offset",), lambda moment: (f"{(moment - START) / timedelta(seconds=1) + 0.25:.2f}",)),
    "milliseconds": (("time_ms",), lambda moment: (f"{(moment - START) // timedelta(milliseconds=1)}",)),
    "since 1970": (("unix time",), lambda moment: (f"{moment.timestamp():.3f}",)),
    "time of day": (("Zeit",), lambda moment: (_time(moment),)),
    "twelve hours": (("Time",), lambda moment: (_clock_12(moment),)),
    "ISO": (("Timestamp",), lambda moment: (f"{moment:%Y-%m-%d} {_time(moment)}",)),
    "with a zone": (("Timestamp",), lambda moment: (moment.isoformat(timespec="milliseconds"),)),
    "German date": (("Datum",), lambda moment: (f"{moment:%d.%m.%Y} {_time(moment)}",)),
    "American date": (("Date Time",), lambda moment: (f"{_american(moment)} {_clock_12(moment)}",)),
    "date and time": (("Date", "Time"), lambda moment: (f"{moment:%Y-%m-%d}", _time(moment))),
    "American date and time": (("Date", "Time"), lambda moment: (_american(moment), _clock_12(moment))),
    "days of a spreadsheet": (("Date",), lambda moment: (f"{_days(moment):.10f}",)),
    "minutes of an hour": (("Time",), lambda moment: (moment.strftime("%M:%S.%f")[:-3],)),
}
OF_NUMBERS: Final = frozenset({"seconds", "bare seconds", "since 1970", "days of a spreadsheet"})
HEADERS: Final[Sequence[tuple[str, ...]]] = (
    ("brackets",), ("names", "units"), ("units", "names"), ("names", "sources", "units"), ("names", "units", "sources"),
    ("addresses", "names", "units"), ("names", "addresses", "units"),
)  # fmt: skip
PREAMBLES: Final[Sequence[tuple[str, ...]]] = (
    (),
    ("Recorder 4.2", ""),
    ("# made by a program", "Car: Golf", "", "[Data]"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """How a table is written."""

    separator: str
    decimal: str
    grouping: str
    clock: str
    header: tuple[str, ...]
    preamble: tuple[str, ...]
    clock_place: int  # among the channels
    has_row_numbers: bool
    has_units_in_cells: bool
    has_surplus_name: bool
    is_ragged: bool
    encoding: str
    newline: str


def drawn(rng: random.Random) -> Dialect:
    """Return a dialect that somebody may write."""
    separator = rng.choice("\t;,|")
    decimal = "." if separator == "," else rng.choice(".,")
    header = rng.choice(HEADERS)
    return Dialect(
        separator=separator,
        decimal=decimal,
        grouping=rng.choice(["", "", *(mark for mark in (",", ".", " ", "'") if mark != decimal)]),
        clock=rng.choice(sorted(CLOCKS)),
        header=header,
        preamble=rng.choice(PREAMBLES),
        clock_place=rng.randrange(3),
        has_row_numbers=rng.random() < 0.3,
        has_units_in_cells=rng.random() < 0.2 and header == ("brackets",),
        has_surplus_name=rng.random() < 0.15,
        is_ragged=rng.random() < 0.2,
        encoding=rng.choice(["utf-8", "utf-8-sig", "cp1252"]),
        newline=rng.choice(["\n", "\r\n"]),
    )


def number(value: float, digits: int, dialect: Dialect) -> str:
    """Return a number in the marks of a dialect."""
    text = f"{value:,.{digits}f}"
    return text.replace(",", "g").replace(".", dialect.decimal).replace("g", dialect.grouping)


def written(drive: Drive, dialect: Dialect) -> bytes:
    """Return a drive as a table."""
    time_names, times = CLOCKS[dialect.clock]
    names = [column.name for column in drive.channels]
    units = [column.unit for column in drive.channels]
    at = dialect.clock_place
    number_names = ["No"] * dialect.has_row_numbers
    bracketed = [f"{name} [{unit}]" for name, unit in zip(names, units, strict=True)]
    blank, count = [""] * len(number_names), len(time_names)
    head = {
        "brackets": [*number_names, *bracketed[:at], *time_names, *bracketed[at:]],
        "names": [*number_names, *names[:at], *time_names, *names[at:]],
        "units": [*blank, *units[:at], *[""] * count, *units[at:]],
        "sources": [*blank, *[""] * at, *["calc"] * count, *["200: obd"] * (len(names) - at)],
        "addresses": [*blank, *[""] * at, *["0x00"] * count, *["0x1F"] * (len(names) - at)],
    }
    surplus = ["MAP 1.bin"] * dialect.has_surplus_name
    rows = [[*head[kind], *(surplus if kind in {"brackets", "names"} else [])] for kind in dialect.header]
    for place, time_ms in enumerate(drive.times_ms):
        cells = [
            "" if (value := values[place]) is None else number(value, digits, dialect) + _behind(column, dialect)
            for column, (digits, values) in drive.channels.items()
        ]
        clock = times(START + timedelta(milliseconds=time_ms))
        if dialect.clock in OF_NUMBERS:
            clock = (clock[0].replace(".", dialect.decimal),)
        row = [*([str(place + 1)] if dialect.has_row_numbers else []), *cells[:at], *clock, *cells[at:]]
        while dialect.is_ragged and row and not row[-1]:
            row.pop()
        rows.append(row)
    text = io.StringIO()
    csv.writer(text, delimiter=dialect.separator, lineterminator=dialect.newline).writerows(rows)
    before = "".join(line + dialect.newline for line in dialect.preamble)
    return (before + text.getvalue()).encode(dialect.encoding)


def _behind(column: SignalColumn, dialect: Dialect) -> str:
    return f" {column.unit}" if dialect.has_units_in_cells else ""


def drive_of(speed_rpm: Sequence[float], pressure_bar: Sequence[float], step_ms: int) -> Drive:
    """Return a drive of three channels in steady steps; oil is told in every fourth row."""
    speed, pressure, temperature = COLUMNS
    oil = [80.0 + row // 20 if row % 4 == 0 else None for row in range(len(speed_rpm))]
    return Drive(
        times_ms=[step_ms * row for row in range(len(speed_rpm))],
        channels={speed: (0, speed_rpm), pressure: (2, pressure_bar), temperature: (0, oil)},
    )


def _rows(drive: Drive) -> list[tuple[int, list[str]]]:
    """Return the time [ms] of each row, and its cells, blank where there is no value."""
    series = [(digits, values) for digits, values in drive.channels.values()]
    return [
        (at, ["" if (value := values[place]) is None else f"{value:.{digits}f}" for digits, values in series])
        for place, at in enumerate(drive.times_ms)
    ]


def _lines(*parts: str | Sequence[str]) -> bytes:
    return "".join(f"{line}\r\n" for part in parts for line in ([part] if isinstance(part, str) else part)).encode()


def vcds(drive: Drive) -> bytes:
    """Return a log of VCDS: a clock before each channel, three rows of a header, a line of the car before it."""
    head = [
        "Marker," + "".join(f"TIME,Loc. IDE0{n:04d}," for n, _ in enumerate(drive.channels)),
        "," + "".join(f"STAMP,{column.name}," for column in drive.channels),
        "," + "".join(f", {column.unit}," for column in drive.channels),
    ]
    rows = ["," + "".join(f"{at / 1000:.3f},{cell}," for cell in cells) for at, cells in _rows(drive)]
    return _lines("Sunday,15,March,2026,10:22:12:40001,Version: Release 24.7.1", "", head, rows)


def car_scanner(drive: Drive) -> bytes:
    """Return a log of Car Scanner: a row for each value."""
    names = [(column.name, column.unit) for column in drive.channels]
    rows = [
        f'"{at / 1000:.3f}";"{name}";"{cell}";"{unit}";'
        for at, cells in _rows(drive)
        for (name, unit), cell in zip(names, cells, strict=True)
    ]
    return _lines('"SECONDS";"PID";"VALUE";"UNITS";', rows)


def race_capture(drive: Drive) -> bytes:
    """Return a log of RaceCapture: name, unit, range and rate of each channel between bars."""
    names = [f'"{column.name}"|"{column.unit}"|0.0|9999.0|25' for column in drive.channels]
    rows = [",".join([str(at), *cells]) for at, cells in _rows(drive)]
    return _lines(",".join(['"Interval"|"ms"|0|0|1', *names]), rows)


def aim(drive: Drive) -> bytes:
    """Return an export of AiM: all cells quoted, names, units and numbers of columns apart by blank lines."""
    quoted = [
        ",".join(f'"{cell}"' for cell in row)
        for row in (
            ["Time", *(column.name for column in drive.channels)],
            ["sec", *(column.unit for column in drive.channels)],
            [str(number + 1) for number in range(1 + len(drive.channels))],
        )
    ]
    rows = [",".join(f'"{cell}"' for cell in [f"{at / 1000:.3f}", *cells]) for at, cells in _rows(drive)]
    before = ['"Format","AiM CSV File"', '"Date","03/15/2026"', '"Time","02:15 PM"', ""]
    return _lines(before, quoted[:2], "", quoted[2], "", rows)


def mega_log_viewer(drive: Drive) -> bytes:
    """Return a log of TunerStudio: tabs, two lines of words before, marks between."""
    names = ["Time", *(column.name for column in drive.channels)]
    rows = ["\t".join([f"{at / 1000:.3f}", *cells]) for at, cells in _rows(drive)]
    before = ['"MS2Extra comms342h2: MS3 Format"', '"Capture Date: Sun Mar 15 10:00:00 GMT 2026"']
    return _lines(before, "\t".join(names), "\t".join(["s", *(column.unit for column in drive.channels)]), rows)


def with_remarks(drive: Drive) -> bytes:
    """Return a table with remarks before and between its rows, and its header commented."""
    names = ["#Time [s]", *(f"{column.name} [{column.unit}]" for column in drive.channels)]
    rows = [",".join([f"{at / 1000:.3f}", *cells]) for at, cells in _rows(drive)]
    return _lines("# made by a logger, 4.2", ",".join(names), rows[:20], "// paused, 3", "# mark, a, b", rows[20:])


def in_two_recordings(drive: Drive) -> bytes:
    """Return a table whose second half has another header: other order of columns, other unit of time."""
    names, units = [column.name for column in drive.channels], [column.unit for column in drive.channels]
    rows, half = _rows(drive), len(drive.times_ms) // 2
    first = [",".join([f"{at / 1000:.3f}", *cells]) for at, cells in rows[:half]]
    then = [",".join([*reversed(cells), str(at)]) for at, cells in rows[half:]]
    return _lines(
        [",".join(["Time", *names]), ",".join(["s", *units])], first, "",
        [",".join([*reversed(names), "Time"]), ",".join([*reversed(units), "ms"])], then,
    )  # fmt: skip


PROGRAMS: Final[Mapping[str, Callable[[Drive], bytes]]] = {
    write.__name__: write
    for write in (vcds, car_scanner, race_capture, aim, mega_log_viewer, with_remarks, in_two_recordings)
}
"""Layouts that are more than a dialect."""
