"""Tables whose columns a header names, or somebody: what they are taken for is said."""

import re
from collections.abc import Sequence
from dataclasses import replace

from canlog.errors import SourceError
from canlog.frames import FrameBatch
from canlog.logs.columns import header
from canlog.logs.columns.header import COMMENTS, LEAST_COLUMNS
from canlog.logs.columns.lines import FileClock, LineReader
from canlog.logs.columns.roles import DAY_US, DECIMAL, HEXADECIMAL, Column, Layout, Role
from canlog.logs.dates import date_us
from canlog.logs.frame_buffer import MOST_CHANNELS, FrameRows
from canlog.logs.log_counts import MICROSECONDS, SECONDS, UNIT_NAMES, likely_unit
from canlog.logs.text_kernels import SKIPPED
from canlog.logs.text_log import LineLog, frames_of

HEADER_LINES_LOOKED_AT = 200  # Vehicle Spy lists up to a hundred networks before
SAMPLE_LINES = 2_000
ENOUGH_BYTES = 8  # of a table without lengths: a frame with so many is whole
HALF_BYTE_AT_END = {
    HEXADECIMAL: re.compile(rb"[^0-9A-Fa-f][0-9A-Fa-f]\n"),
    DECIMAL: re.compile(rb"[^0-9][0-9]{1,2}\n"),
}
WHOLE_BYTE_AT_END = re.compile(rb"[0-9A-Fa-f]{2}[\"\s]*$")
LABELLED = re.compile(rb"\d+\.\d+,[0-9A-Fa-f]{3,8},[0-8](?:,[0-9A-Fa-f]{2}){0,8},[RT]\s*")  # R: regular, T: injected
LABELLED_COLUMNS = "time=1:s,id=2:hex,length=3,data=4-11"  # of HCRL's car hacking data set, which has no header
CLOCK = re.compile(r"\d{1,2}:\d\d:\d\d")
DATE = re.compile(r"\d{4}[-/]\d\d[-/]\d\d[ T]\d{1,2}:\d\d:\d\d(?:[.,]\d+)?(?P<offset>\S*)$")
NO_HEADER = "no line names its columns"
NO_TIMES = "the log has no times: every frame gets the time 1970-01-01 00:00:00"
NO_LAYOUT = Layout(columns=(Column(),), separator=ord(","))


class TableLog(LineLog):
    """A table of a known layout; ``set_layout`` says another, before the first line or by what one says."""

    def __init__(self, layout: Layout = NO_LAYOUT) -> None:
        super().__init__()
        self._clock = FileClock()
        self.set_layout(layout)

    def set_layout(self, layout: Layout) -> None:
        """Read the lines that follow by a layout."""
        self.layout, self._reader, self._header_lines = layout, LineReader(layout), layout.header_lines
        self.shortest_line_bytes = 7 if layout.is_exact else 3  # "0 DT 1" and "1,2", each with its newline
        self._clock.wrap_us = layout.wrap_us

    def set_base(self, base_us: int, now_us: int = 0, *, is_relative: bool = False) -> None:
        """Count times from here, of which so much has passed; each from the one before if ``is_relative``."""
        self._clock = FileClock(base_us=base_us, now_us=now_us, wrap_us=self.layout.wrap_us, is_relative=is_relative)

    def read_line(self, line: bytes, rows: FrameRows, row: int) -> int:
        """Read a line; a comment of an exact layout is for ``read_comment``."""
        if self._header_lines > 0:
            self._header_lines -= 1
            return SKIPPED
        return self._reader.read(line, self._clock, rows, row)

    def is_whole(self, line: bytes, frame: FrameBatch) -> bool:
        """Return whether no byte can be missing, and no digit of the last one."""
        layout = self.layout
        tells_length = layout.has(Role.LENGTH) or layout.has(Role.LENGTH_CODE)
        if frame.length[0] < (1 if tells_length else ENOUGH_BYTES):
            return False
        if layout.is_exact:
            last = layout.columns[-1]
            return last.role is not Role.DATA or HALF_BYTE_AT_END[last.parameter].search(line[-4:]) is None
        places = [place for place, column in enumerate(layout.columns) if column.role in {Role.DATA, Role.BYTE}]
        is_followed = len(header.names_in(line, layout.separator)) > places[-1] + 1 if places else False
        return is_followed or WHOLE_BYTE_AT_END.search(line) is not None


class ColumnsLog(TableLog):
    """A table of separated columns, whose header names them, or ``choice``: ``time=Time,id=ID,data=D1-D8``."""

    def __init__(self, choice: str = "") -> None:
        super().__init__()
        self._choice = choice
        self.taken_for = ""

    def look_ahead(self, text: bytes) -> None:
        """Find the header, and out of the first lines what it leaves open; raises SourceError if it cannot be used."""
        lines = text.splitlines()
        number, separator, found = _header_of(lines, self._choice)
        body = lines[number : number + SAMPLE_LINES]
        rows = [header.names_in(line, separator) for line in body if line.strip() and not line.startswith(COMMENTS)]
        self.taken_for = found.in_words()
        columns = tuple(self._based(column, place, rows, found.names) for place, column in enumerate(found.columns))
        id_digits = {len(value.lower().removeprefix("0x")) for value in _values(columns, Role.ID, rows)}
        self.set_layout(
            Layout(
                columns=columns,
                separator=separator,
                comment_starts=COMMENTS,
                header_lines=number,
                extended_digits=8 if 8 in id_digits and id_digits & {3, 4} else 0,  # where others have 3, or 4
                has_decimal_comma=separator != ord(","),
                names=found.names,
                channel_names=self._channel_names(_values(columns, Role.CHANNEL, rows)),
            )
        )
        self._set_time_unit(found, rows, b"\n".join(body))

    def _based(self, column: Column, place: int, rows: Sequence[tuple[str, ...]], names: Sequence[str]) -> Column:
        """Return a column with its numbers in the base that they must have."""
        if column.role is not Role.ID or column.parameter != header.NO_BASE:
            return column
        base, why = header.base_of((row[place] for row in rows if place < len(row)), names)
        if why:
            self.notes.append(f"identifiers are taken as {'decimal' if base == DECIMAL else 'hexadecimal'}: {why}")
        return replace(column, parameter=base)

    def _channel_names(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of channels whose numbers at their ends do not tell them apart, in the order they came."""
        seen = tuple(dict.fromkeys(names))[:MOST_CHANNELS]
        if len({(re.search(r"\d*$", name) or [""])[0] for name in seen}) == len(seen):
            return ()
        self.notes.append(f"channels are numbered by name: {', '.join(f'{n} {name}' for n, name in enumerate(seen))}")
        return seen

    def _set_time_unit(self, found: header.Proposal, rows: Sequence[tuple[str, ...]], body: bytes) -> None:
        """Find out what the times count, and from when."""
        layout = self.layout
        times = _values(layout.columns, Role.TIME, rows)
        if not layout.has(Role.TIME):
            self.notes.append(NO_TIMES)
        elif times and (date := DATE.match(times[0])):
            if not date["offset"]:
                self._set_local_dates(times[0])
        elif times and CLOCK.match(times[0]):
            self.set_layout(replace(layout, wrap_us=DAY_US))
            self.notes.append("times are times of day, taken as those of 1970-01-01")
        elif times and not found.has_unit:
            unit = SECONDS  # where they have fractions; else what a bus can carry
            if not any("." in time or "," in time for time in times):
                counted = replace(layout, columns=header.in_unit(layout.columns, MICROSECONDS), header_lines=0)
                unit = likely_unit(frames_of(TableLog(counted), body))[0]
            self.notes.append(f"times are taken as {UNIT_NAMES[unit]}: the header does not say")
            self.set_layout(replace(layout, columns=header.in_unit(layout.columns, unit)))

    def _set_local_dates(self, date: str) -> None:
        """Take dates without an offset as local time, all with the offset of the first."""
        local_us = date_us(date.replace("T", " ").replace("/", "-").encode())
        layout = Layout(columns=(Column(Role.TIME), Column(Role.ID, 16)), separator=ord(";"))
        as_utc = frames_of(TableLog(layout), date.encode() + b";1")
        if local_us is not None and len(as_utc):
            self.set_base(local_us - int(as_utc.t_ns[0]) // 1_000)
            self.notes.append("dates are taken as local time: they have no UTC offset")


def columns_seen(text: bytes) -> tuple[str, ...]:
    """Return the names of the columns of what looks like a table; none if it does not."""
    for line in text.splitlines()[:HEADER_LINES_LOOKED_AT]:
        separator = header.separator_of(line)
        names = header.names_in(line, separator)
        if len(names) > LEAST_COLUMNS and all(name and not _is_number(name) for name in names) and line.isascii():
            return names
    return ()


def _header_of(lines: Sequence[bytes], choice: str) -> tuple[int, int, header.Proposal]:
    """Return how many lines there are up to the header, the separator, and what the columns are taken for."""
    if choice and header.are_numbers(choice):
        return _numbered(lines, choice)
    complaint: SourceError | None = None
    for number, line in enumerate(lines[:HEADER_LINES_LOOKED_AT], 1):
        separator = header.separator_of(line)
        names = header.names_in(line, separator)
        if len(names) < LEAST_COLUMNS or all(_is_number(name) for name in names):
            continue
        if not choice:
            if found := header.proposal(names):
                return _behind_headers(lines, number, separator, names), separator, found
            continue
        try:
            found = header.chosen(choice, names)
            return _behind_headers(lines, number, separator, names), separator, found
        except SourceError as exc:
            complaint = complaint or exc
    sample = [line for line in lines if line.strip()][:HEADER_LINES_LOOKED_AT]
    if not choice and sum(LABELLED.fullmatch(line) is not None for line in sample) * 2 > len(sample):
        return _numbered(lines, LABELLED_COLUMNS)
    raise complaint or SourceError(NO_HEADER)


def _behind_headers(lines: Sequence[bytes], number: int, separator: int, names: Sequence[str]) -> int:
    """Return how many lines there are up to the last header: one for another network begins with the same columns."""
    while number < len(lines) and header.names_in(lines[number], separator)[:LEAST_COLUMNS] == names[:LEAST_COLUMNS]:
        number += 1
    return number


def _numbered(lines: Sequence[bytes], choice: str) -> tuple[int, int, header.Proposal]:
    """Return the same of columns that are named by their numbers: the header ends where the first frame is."""
    first_line = next((line for line in lines if line.strip() and not line.startswith(COMMENTS)), b"")
    separator = header.separator_of(first_line)
    found = header.chosen(choice, ())
    columns = tuple(replace(one, parameter=HEXADECIMAL) if one.role is Role.ID else one for one in found.columns)
    reader = TableLog(Layout(columns=columns, separator=separator, has_decimal_comma=separator != ord(",")))
    numbers = range(min(len(lines), HEADER_LINES_LOOKED_AT))
    first = next((number for number in numbers if len(frames_of(reader, lines[number]))), 0)
    return first, separator, found


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", ".").removeprefix("0x"))
    except ValueError:
        return False
    return True


def _values(columns: Sequence[Column], role: Role, rows: Sequence[tuple[str, ...]]) -> list[str]:
    place = next((place for place, column in enumerate(columns) if column.role is role), None)
    return [] if place is None else [row[place] for row in rows if place < len(row) and row[place]]
