"""Layouts of what programs write of a bus, a line for each frame; some say in their first lines how."""

import calendar
import re
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from typing import Final

from canlog.logs.columns.lines import (
    BLANKS,
    COMMA,
    DAY_US,
    DECIMAL,
    HEXADECIMAL,
    MINUTE_US,
    Column,
    Layout,
    Meaning,
    Role,
)
from canlog.logs.columns.log import TableLog, in_unit, names_in
from canlog.logs.dates import date_us, local_midnight_us
from canlog.logs.log_counts import MICROSECONDS, MILLISECONDS, SECONDS, likely_unit
from canlog.logs.text_log import frames_of

PYTHON_CAN_HEADER = re.compile(rb"\s*timestamp,arbitration_id,extended,remote,error,dlc,data\s*\Z", re.IGNORECASE)
GVRET_HEADER = re.compile(rb"\s*time stamp,id,extended,", re.IGNORECASE)

# Columns of several formats.
HEX_ID, HEX_DATA = (Column(role, HEXADECIMAL) for role in (Role.ID, Role.DATA))
LENGTH, CHANNEL, DIRECTION = (Column(role) for role in (Role.LENGTH, Role.CHANNEL, Role.DIRECTION))
TIME_S = Column(Role.TIME, SECONDS)

PYTHON_CAN = Layout(
    columns=(
        TIME_S,
        HEX_ID,
        Column(Role.EXTENDED),
        Column(Role.REMOTE),
        Column(Role.ERROR),
        LENGTH,
        Column(Role.BASE64),
    ),
    separator=COMMA,
    comment_starts=b"tT",
    is_exact=True,
)
_GVRET_START = (Column(Role.TIME, MICROSECONDS), HEX_ID, Column(Role.EXTENDED))
_GVRET_END = (CHANNEL, LENGTH, HEX_DATA)
GVRET = Layout(columns=_GVRET_START + _GVRET_END, separator=COMMA, comment_starts=b"tT", is_exact=True, is_padded=True)
GVRET_WITH_DIRECTION = replace(GVRET, columns=(*_GVRET_START, DIRECTION, *_GVRET_END))


class PythonCanCsv(TableLog):
    """The CSV of python-can's ``CSVWriter``; it does not tell CAN FD apart, but longer payloads are."""

    def __init__(self) -> None:
        super().__init__(PYTHON_CAN)

    def read_comment(self, line: bytes) -> bool:
        return PYTHON_CAN_HEADER.match(line) is not None


EPOCH_US: Final = (10**15, 4 * 10**15)  # of the years 2001 to 2096


class GvretCsv(TableLog):
    """The CSV of GVRET devices and SavvyCAN, with or without the column of directions."""

    def __init__(self) -> None:
        super().__init__(GVRET)
        self._unit = MICROSECONDS

    def read_comment(self, line: bytes) -> bool:
        if not GVRET_HEADER.match(line):
            return False
        self._set_layout(GVRET_WITH_DIRECTION if b",dir," in line.lower() else GVRET)
        return True

    def look_ahead(self, text: bytes) -> None:
        """Find out the unit of times, and whether those below zero count from 1970 all the same."""
        frames = frames_of(GvretCsv(), text)
        self._unit, note = likely_unit(frames)
        self._set_layout(self.layout)
        self.notes += note
        first_us = int(frames.t_ns[0]) // 1_000 * 10**self._unit if len(frames) else 0
        if EPOCH_US[0] <= -first_us < EPOCH_US[1]:
            self.set_base(-2 * first_us)
            self.notes.append("times are below zero: their amounts are taken as microseconds since 1970")

    def _set_layout(self, layout: Layout) -> None:
        self.set_layout(replace(layout, columns=in_unit(layout.columns, self._unit)))


CRTD = Layout(
    columns=(
        TIME_S,
        Column(Role.WORD, ord("c")),  # comments, events, states: CXX, CEV, CST and more
        HEX_ID,
        HEX_DATA,
    ),
    separator=BLANKS,
    comment_starts=b"",
    is_exact=True,
    words={
        "r11": Meaning.NOTHING,
        "t11": Meaning.SENT,
        "r29": Meaning.EXTENDED,
        "t29": Meaning.SENT | Meaning.EXTENDED,
    },
)


DAYS_TO_EPOCH = 25_569  # from 1899-12-30 to 1970-01-01
MOST_DAYS = 120_000
STANDARD_DIGITS = 4

VERSION = re.compile(rb";\$FILEVERSION\s*=\s*(\d\.\d)", re.IGNORECASE)
START_DAYS = re.compile(rb";\$STARTTIME\s*=\s*([\d.]{1,40})", re.IGNORECASE)
COLUMNS = re.compile(rb";\$COLUMNS\s*=\s*([A-Za-z,\s]+)", re.IGNORECASE)
UNKNOWN_DATE = re.compile(rb";\s*Start time:\s*\S")
START_DATE = re.compile(rb";\s*Start time:\s*(\d+)\.(\d+)\.(\d{4})\s+(\d+):(\d+):(\d+)(?:\.(\d{1,3}))?")

OLD_WORDS = {
    "rx": Meaning.NOTHING,
    "tx": Meaning.SENT,
    "rtr": Meaning.REMOTE,
    "error": Meaning.ERROR,
    "warng": Meaning.EVENT,
}
NEW_WORDS = {
    "dt": Meaning.NOTHING,
    "fd": Meaning.FD,
    "fb": Meaning.FD | Meaning.BIT_RATE_SWITCH,
    "fe": Meaning.FD | Meaning.BIT_RATE_SWITCH | Meaning.ERROR_STATE,
    "bi": Meaning.FD | Meaning.ERROR_STATE,
    "rr": Meaning.REMOTE,
    "er": Meaning.ERROR,
    "st": Meaning.EVENT,
    "ec": Meaning.EVENT,
    "ev": Meaning.EVENT,
    "rtr": Meaning.REMOTE,
}
# By the letters that ``$COLUMNS`` has for them; older versions have no such line, but columns of the same kinds.
COLUMN_OF_LETTER = {
    "N": Column(Role.IGNORED),
    "O": Column(Role.TIME, MILLISECONDS),
    "T": Column(Role.WORD),
    "B": Column(Role.CHANNEL),
    "I": Column(Role.ID, HEXADECIMAL),
    "d": Column(Role.DIRECTION),
    "R": Column(Role.IGNORED),  # reserved
    "l": Column(Role.LENGTH),
    "L": Column(Role.LENGTH_CODE),
    "D": Column(Role.DATA, HEXADECIMAL),
}
NEEDED_LETTERS, MOST_LETTERS = set("OTI"), 15


def trc_layout(letters: str, words: Mapping[str, Meaning]) -> Layout:
    return Layout(
        columns=tuple(COLUMN_OF_LETTER[letter] for letter in letters),
        separator=BLANKS,
        extended_digits=STANDARD_DIGITS + 1,
        words=words,
        comment_starts=b";",
        is_exact=True,
    )


LAYOUTS = {
    b"1.0": trc_layout("NOILD", OLD_WORDS),
    b"1.1": trc_layout("NOTILD", OLD_WORDS),
    b"1.2": trc_layout("NOBTILD", OLD_WORDS),
    b"1.3": trc_layout("NOBTIRLD", OLD_WORDS),
    b"2.0": trc_layout("NOTIdlD", NEW_WORDS),
    b"2.1": trc_layout("NOTBIdRLD", NEW_WORDS),
}


class Trc(TableLog):
    """The trace of PCAN-View and PCAN-Explorer; without a version it is 1.0."""

    def __init__(self) -> None:
        super().__init__(LAYOUTS[b"1.0"])
        self._has_start = False

    def read_comment(self, line: bytes) -> bool:
        if version := VERSION.match(line):
            self.set_layout(LAYOUTS.get(version[1], self.layout))
            return version[1] in LAYOUTS
        if columns := COLUMNS.match(line):
            return self._set_columns(columns[1])
        if days := START_DAYS.match(line):
            return self._set_start(_days_us(days[1]))
        if (date := START_DATE.match(line)) and not self._has_start:
            return self._set_start(_date_us(date))
        if UNKNOWN_DATE.match(line) and not self._has_start:
            self.notes.append("the start time of the log is not understood: times count from 1970")
        return True

    def _set_columns(self, listed: bytes) -> bool:
        letters = "".join(listed.decode("ascii").replace(",", " ").split())
        is_usable = NEEDED_LETTERS <= set(letters) <= COLUMN_OF_LETTER.keys() and len(letters) <= MOST_LETTERS
        if is_usable:
            self.set_layout(trc_layout(letters, NEW_WORDS))
        return is_usable

    def _set_start(self, start_us: int | None) -> bool:
        self._has_start |= start_us is not None
        if start_us is not None:
            self.set_base(start_us)
        return start_us is not None


def _days_us(text: bytes) -> int | None:
    """Return days since 1899-12-30 as microseconds since the epoch; None if they are none, or before it."""
    try:
        days = Decimal(text.decode("ascii"))
    except InvalidOperation:
        return None
    if not DAYS_TO_EPOCH <= days <= MOST_DAYS:
        return None
    return round((days - DAYS_TO_EPOCH) * DAY_US)


def _date_us(match: re.Match[bytes]) -> int | None:
    """Return ``11.09.2002 16:00:20.682`` in microseconds since the epoch; None if there is no such time."""
    day, month, year, hour, minute, second = (int(match[number]) for number in range(1, 7))
    try:
        start = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    return int(start.timestamp()) * 1_000_000 + int((match[7] or b"0").ljust(3, b"0")) * 1_000


BUSMASTER_START = re.compile(rb"\*\*\*START DATE AND TIME\s+(?P<date>[^*]*)")
MODE = re.compile(rb"\*\*\*(SYSTEM|ABSOLUTE|RELATIVE) MODE\*\*\*")
PROTOCOL = re.compile(rb"\*\*\*PROTOCOL (\w+)\*\*\*")
BASES = {b"***DEC***": True, b"***HEX***": False}
COUNT = re.compile(rb"^\s*\d+:\d+:\d+:(\d+)\s", re.MULTILINE)
USUAL_DIGITS, USUAL_UNIT_US = 4, 100
MILLISECOND_US = 1_000

WORDS = {
    "rx": Meaning.NOTHING,
    "tx": Meaning.SENT,
    "s": Meaning.NOTHING,
    "x": Meaning.EXTENDED,
    "sr": Meaning.REMOTE,
    "xr": Meaning.EXTENDED | Meaning.REMOTE,
    "s-fd": Meaning.FD,
    "x-fd": Meaning.FD | Meaning.EXTENDED,
}


J1939_WORDS = {"rx": Meaning.EXTENDED, "tx": Meaning.EXTENDED | Meaning.SENT}
J1939_COLUMNS_BETWEEN = 5  # group, kind, source, destination and priority, all of them parts of the identifier


def busmaster_layout(unit_us: int, *, is_decimal: bool, is_j1939: bool) -> Layout:
    """Return the layout of lines whose clock has counts of so many microseconds."""
    base = DECIMAL if is_decimal else HEXADECIMAL
    clock, channel, word = Column(Role.CLOCK, unit_us), Column(Role.CHANNEL), Column(Role.WORD)
    identifier = Column(Role.ID, base)
    j1939 = (clock, channel, identifier, *[Column()] * J1939_COLUMNS_BETWEEN, word)
    return Layout(
        columns=(
            *(j1939 if is_j1939 else (clock, word, channel, identifier, word)),
            Column(Role.LENGTH),
            Column(Role.DATA, base),
        ),
        separator=BLANKS,
        words=J1939_WORDS if is_j1939 else WORDS,
        comment_starts=b"*",
        is_exact=True,
    )


class Busmaster(TableLog):
    """A log of BUSMASTER; a line of its header says whether identifiers and bytes are hexadecimal or decimal."""

    def __init__(self) -> None:
        self._unit_us = USUAL_UNIT_US
        self._start_us: int | None = None
        self._mode = b"SYSTEM"
        self._is_decimal = self._is_j1939 = False
        super().__init__()
        self._set_layout()

    def look_ahead(self, text: bytes) -> None:
        """Find out the unit of the clock's counts."""
        digits = max((len(count) for count in COUNT.findall(text)), default=USUAL_DIGITS)
        if digits < USUAL_DIGITS:
            self.notes.append(
                f"times are taken as milliseconds: none has the {USUAL_DIGITS} digits that BUSMASTER writes"
            )
        self._unit_us = MILLISECOND_US if digits < USUAL_DIGITS else USUAL_UNIT_US if digits == USUAL_DIGITS else 1
        self._set_layout()

    def read_comment(self, line: bytes) -> bool:
        if not line.startswith(b"***"):
            return False
        if match := BUSMASTER_START.match(line):
            self._start_us = date_us(match["date"])
            if self._start_us is None:
                self.notes.append("the start of the log is not understood: times count from 1970")
            self._set_clock()
        elif match := MODE.match(line):
            self._mode = match[1]
            self._set_clock()
        elif line in BASES:
            self._is_decimal = BASES[line]
            self._set_layout()
        elif match := PROTOCOL.match(line):
            self._is_j1939 = match[1].upper() == b"J1939"
            self._set_layout()
        return True

    def _set_layout(self) -> None:
        """Apply what the header said; without a start, times count from 1970."""
        is_daytime = self._mode == b"SYSTEM"
        layout = busmaster_layout(self._unit_us, is_decimal=self._is_decimal, is_j1939=self._is_j1939)
        self.set_layout(replace(layout, wrap_us=DAY_US if is_daytime else 0))

    def _set_clock(self) -> None:
        self._set_layout()
        start_us = self._start_us or 0
        passed_us = start_us - local_midnight_us(start_us) if self._start_us and self._mode == b"SYSTEM" else 0
        self.set_base(start_us - passed_us, passed_us, is_relative=self._mode == b"RELATIVE")


SENT: Final = 0x8  # of a frame's type; its lowest bit says that the identifier has 29 bits
ENTRY: Final = re.compile(rb"^# (Value separator|Time): *\"?([^\"\r\n]*)", re.MULTILINE)
CLX000_HEADER: Final = re.compile(rb"# Logger type: (?:CL|CANLogger)")
CLX000_START: Final = re.compile(r"(\d{4})(\d\d)(\d\d)(\d\d)(\d\d)(\d\d)")
ROLES: Final[Mapping[str, Column]] = {
    "timestamp": Column(Role.STAMP),
    "type": Column(Role.FLAGS, SENT),
    "id": Column(Role.ID, HEXADECIMAL),
    "length": Column(Role.LENGTH),
    "data": Column(Role.DATA, HEXADECIMAL),
}  # others are passed over
# Digits of a time up to its days, hours and so on, and the period of each; 0: the length of the month.
DAY_DIGITS, HOUR_DIGITS, MINUTE_DIGITS, SECOND_DIGITS, FRACTION_DIGITS = 11, 9, 7, 5, 3
LAPS_US: Final[Mapping[int, int]] = {
    DAY_DIGITS: 0,
    HOUR_DIGITS: DAY_US,
    MINUTE_DIGITS: 60 * MINUTE_US,
    SECOND_DIGITS: MINUTE_US,
    FRACTION_DIGITS: 1_000_000,
}
USUAL_NAMES: Final = ("timestamp", "type", "id", "data")
CLX000: Final = Layout(columns=tuple(ROLES[name] for name in USUAL_NAMES), separator=ord(";"))
NO_NAMES: Final = "no line names the columns: the default columns of the loggers are assumed"
NO_START: Final = "the header has no start time: times count from 1970"


class Clx000(TableLog):
    def __init__(self) -> None:
        super().__init__(CLX000)

    def look_ahead(self, text: bytes) -> None:
        """Find the columns, and from when the times count."""
        entries = {name: value.decode("ascii", "replace") for name, value in ENTRY.findall(text)}
        separator = ord((entries.get(b"Value separator") or ";")[0])
        lines = text.splitlines()
        place = next((place for place, line in enumerate(lines) if line.strip() and not line.startswith(b"#")), None)
        if place is None or separator > ord("~"):
            return
        names = tuple(name.lower() for name in names_in(lines[place], separator))
        if "id" not in names:
            self.notes.append(NO_NAMES)
            place, names = place - 1, USUAL_NAMES
        columns = tuple(ROLES.get(name, Column()) for name in names)
        self.set_layout(Layout(columns=columns, separator=separator, header_lines=place + 1, names=names))
        if "timestamp" in names and len(lines) > place + 1:
            stamp = dict(zip(names, names_in(lines[place + 1], separator), strict=False)).get("timestamp", "")
            self._set_time_unit(
                "".join(filter(str.isdigit, stamp)), "".join(filter(str.isdigit, entries.get(b"Time", "")))
            )

    def _set_time_unit(self, stamp: str, start: str) -> None:
        """Find out from when times count of which the first has these digits, and when they begin again."""
        parts = [int(part) for part in match.groups()] if (match := CLX000_START.match(start)) else []
        is_date = bool(parts) and 1 <= parts[1] <= 12
        if not is_date:
            self.notes.append(NO_START)
        year, month, day, *clock = parts if is_date else (1970, 1, 1, 0, 0, 0)
        digits = len(stamp)
        if digits > DAY_DIGITS:
            columns = tuple(
                replace(column, parameter=year) if column.role is Role.STAMP else column
                for column in self.layout.columns
            )
            self.set_layout(replace(self.layout, columns=columns))
            local_us = _local_us(year, month, day, *clock)
            self.set_base(local_us - calendar.timegm((year, month, day, *clock)) * 1_000_000 if local_us else 0)
            return
        lap_us = LAPS_US.get(digits, 0) or calendar.monthrange(year, month)[1] * DAY_US
        # Parts that the times lack are those of the header; the others begin at their least.
        stated = [day, *clock][: (DAY_DIGITS - digits) // 2]
        least = [1, 0, 0, 0][len(stated) :]
        self.set_layout(replace(self.layout, wrap_us=lap_us))
        self.set_base(_local_us(year, month, *stated, *least) or 0)


def _local_us(year: int, month: int, day: int, hour: int, minute: int, second: int) -> int | None:
    """Return a time of a clock on the wall [us]; None if there is no such day."""
    return date_us(b"%d-%02d-%02d %02d:%02d:%02d" % (year, month, day, hour, minute, second))
