"""Layouts of programs whose headers are no row of names: each finds its own in the first lines of a table."""

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from canlog.logs.dates import moment_of
from canlog.logs.signal_tables.cells import NUMBER
from canlog.logs.signal_tables.clock import OfDay, Packed, TimeReading
from canlog.logs.signal_tables.dialect import Dialect, stripped
from canlog.logs.signal_tables.header import PREAMBLE_ROWS, UNITS, HeaderRows, named_header

COMMAS: Final = Dialect(separator=",", why="as this program writes")
BLANKS: Final = Dialect(separator=" ", why="as this program writes")


@dataclass(frozen=True, slots=True, kw_only=True)
class Sheet:
    """The first lines of a table, and the cells in them."""

    lines: Sequence[str]
    rows: Sequence[Sequence[str]]
    dialect: Dialect


class Stated(NamedTuple):
    """A header, and what its program is known to write as times; None where the cells must show it."""

    header: HeaderRows
    reading: TimeReading | None = None
    base_us: float = 0.0  # that times count from


Layout = Callable[[Sheet], Iterator[Stated]]

HALTECH: Final = "%DataLog%"
HALTECH_UNITS: Final = {
    "EngineSpeed": "rpm", "Pressure": "0.1 kPa", "AbsPressure": "0.1 kPa", "Temperature": "0.1 K", "Speed": "0.1 km/h",
    "Percentage": "0.1 %", "Angle": "0.1 deg", "BatteryVoltage": "mV", "Time_us": "us",
}  # fmt: skip
"""Units of the whole numbers of Haltech's NSP by the type of a channel, as public readers of its exports have them."""


def haltech(sheet: Sheet) -> Iterator[Stated]:
    """Yield the header of an export of Haltech's NSP: lines of keys, then rows that begin with a time of day."""
    if not sheet.lines or sheet.lines[0].strip() != HALTECH:
        return
    starts = (line.partition(",")[0] for line in sheet.lines)
    first = next((n for n, cell in enumerate(starts) if moment_of(cell) is not None), len(sheet.lines))
    names, units, day_us = ["Time"], [""], 0.0
    for line in sheet.lines[:first]:
        key, _, value = (part.strip() for part in line.partition(" : "))
        if key == "Channel":
            names.append(value)
            units.append("")
        elif key == "Type":
            units[-1] = HALTECH_UNITS.get(value, "")
        elif key == "Log" and (day := re.match(r"(\d{4})(\d\d)(\d\d)\b", value)):
            midnight = moment_of("-".join(day.groups()))
            day_us = midnight.us if midnight is not None else 0.0
    if len(names) > 1:
        why = f"{HALTECH} begins it, and {len(names) - 1} lines name its channels"
        header = HeaderRows(
            names=tuple(names), units=tuple(units), place=first, first=first, dialect=COMMAS, clock_places=(0,), why=why
        )
        yield Stated(header, OfDay(), day_us)


RACE_CAPTURE: Final = re.compile(
    r'"?(?P<name>[^"|,]+)"?\|"?(?P<unit>[^"|,]*)"?\|(?P<low>[-+\d.]+)\|(?P<high>[-+\d.]+)\|(?P<rate>[-+\d.]+)(?:,|\s*$)'
)


def race_capture(sheet: Sheet) -> Iterator[Stated]:
    """Yield the header of RaceCapture: each name with its unit, range and rate between bars."""
    for place, line in enumerate(sheet.lines[:PREAMBLE_ROWS]):
        found = list(RACE_CAPTURE.finditer(line))
        if len(found) > 1 and "".join(one[0] for one in found) == line:
            names, units = (tuple(one[key].strip() for one in found) for key in ("name", "unit"))
            why = f"line {place + 1} has name, unit, range and rate of each channel"
            clocks = tuple(n for n, name in enumerate(names) if name.casefold() == "interval")
            yield Stated(
                HeaderRows(
                    names=names, units=units, place=place, first=place + 1, dialect=COMMAS, clock_places=clocks, why=why
                )
            )


VBOX_CREATED: Final = re.compile(r"File created on (\d{1,2})/(\d{1,2})/(\d{4})")
VBOX_UNITS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("sats", "time", "lat", "long", "solution_type", "avifileindex", "event-1"), ""),
    "velocity": "km/h",
    "heading": "deg",
    "height": "m",
    "vert-vel": "m/s",
    "vertvel": "m/s",
    "sampleperiod": "s",
    "avisynctime": "ms",
    "avitime": "ms",
}
"""Columns that every file of Racelogic's VBOX may have, with their units; the others have theirs in a section."""
VBOX_SPEEDS: Final = {"velocity kmh": "km/h", "velocity knots": "kn", "velocity mph": "mph"}


def vbox(sheet: Sheet) -> Iterator[Stated]:
    """Yield the header of Racelogic's VBOX: sections, one of which names the columns; times of day have no marks."""
    sections, data = _sections(sheet.lines)
    names = " ".join(sections.get("column names", ())).split()
    if data is None or "time" not in names:
        return
    own = [place for place, name in enumerate(names) if name.casefold() not in VBOX_UNITS]
    listed = [*sections.get("channel units", ()), *[""] * len(own)]
    units = [VBOX_UNITS.get(name.casefold(), "") for name in names]
    for place, unit in zip(own, listed, strict=False):
        units[place] = unit.strip("()")
    for spelled, unit in VBOX_SPEEDS.items():
        if spelled in sections.get("header", ()) and "velocity" in names:
            units[names.index("velocity")] = unit
    created = next((day for line in sections.get("", ()) if (day := VBOX_CREATED.search(line))), None)
    midnight = moment_of("{2}-{1:0>2}-{0:0>2}".format(*created.groups())) if created else None
    note = f"times of day are those of UTC on the day of the file: {created[0]}" if created else ""
    header = HeaderRows(
        names=tuple(names), units=tuple(units), place=data, first=data + 1, dialect=BLANKS,
        clock_places=(names.index("time"),), why="sections of a VBOX name its columns", notes=(note,) * bool(note),
    )  # fmt: skip
    yield Stated(header, Packed(), midnight.us if midnight is not None else 0.0)


def _sections(lines: Sequence[str]) -> tuple[dict[str, list[str]], int | None]:
    """Return the lines before the values by the titles that stand over them in brackets, and where that of data is."""
    sections, title = dict[str, list[str]](), ""
    for number, text in enumerate(lines):
        line = text.strip()
        if line.startswith("[") and line.endswith("]"):
            title = line[1:-1].casefold()
            if title == "data":
                return sections, number
        elif line:
            sections.setdefault(title, []).append(line)
    return sections, None


TIMES_OF_VCDS: Final = frozenset({"TIME", "ZEIT", "CZAS", "TEMPS", "TIEMPO", "TEMPO", "ČAS", "TID", "TIJD", "VREME"})
STAMPS_OF_VCDS: Final = frozenset({"STAMP", "MARKE", "MARKA", *TIMES_OF_VCDS})


def vcds(sheet: Sheet) -> Iterator[Stated]:
    """Yield headers of VCDS, which stacks three rows: TIME stands over STAMP, or over that word of another language.

    Logs of identifiers have place, name and unit of one signal below each other; those of groups a name in two rows,
    and the units beside STAMP.
    """
    rows = sheet.rows
    for place in range(min(PREAMBLE_ROWS, len(rows) - 2)):
        below, last = rows[place + 1], rows[place + 2]
        clocks = _clocks_of_vcds(rows[place], below)
        if not clocks:
            continue
        width = max(len(stripped(row)) for row in (rows[place], below))
        is_of_values = any(NUMBER.fullmatch("".join(last[clock : clock + 1]).strip()) for clock in clocks)
        above = rows[place - 1] if is_of_values and place else below
        parts = [[*row, *[""] * width][:width] for row in ((above, rows[place]) if is_of_values else (below,))]
        names = [" ".join(filter(None, map(str.strip, cells))) for cells in zip(*parts, strict=True)]
        units = [*(below if is_of_values else last), *[""] * width][:width]
        for number, clock in enumerate(clocks, 1):
            names[clock], units[clock] = f"time {number}", "s"
        first = place + (2 if is_of_values else 3)
        why = f"{rows[place][clocks[0]].strip()} stands over {below[clocks[0]].strip()} in line {place + 1}, as in VCDS"
        yield Stated(
            HeaderRows(
                names=tuple(names), units=tuple(units), place=place, first=first, dialect=sheet.dialect,
                clock_places=clocks, why=why,
            )
        )  # fmt: skip


def _clocks_of_vcds(times: Sequence[str], below: Sequence[str]) -> tuple[int, ...]:
    """Return where a word for time stands over the same word for a stamp: a known one, or one that comes twice.

    A channel may be called a time as well; below that stands its unit.
    """
    words = {
        n: word.strip().upper() for n, (time, word) in enumerate(zip(times, below, strict=False)) if _is_time(time)
    }
    counts = Counter(words.values())
    stamps = [word for word, count in counts.items() if word in STAMPS_OF_VCDS or (count > 1 and _may_be_stamp(word))]
    return tuple(place for place, word in words.items() if word in stamps[:1])


def _is_time(cell: str) -> bool:
    return cell.strip().upper() in TIMES_OF_VCDS


def _may_be_stamp(word: str) -> bool:
    return len(word) > 3 and word.isalpha() and word.casefold() not in UNITS


def named(sheet: Sheet) -> Iterator[Stated]:
    """Yield headers that begin with a row of names, from the top."""
    for place in range(min(PREAMBLE_ROWS, len(sheet.rows))):
        if len(sheet.rows[place]) > 1 and (header := named_header(sheet.rows, place, sheet.dialect)) is not None:
            yield Stated(header)


LAYOUTS: Final[tuple[Layout, ...]] = (haltech, vbox, race_capture, vcds, named)
"""The likeliest first: what is in none of the others has a row of names."""
