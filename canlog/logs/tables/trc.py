"""PCAN trace files, versions 1.0 to 2.1: milliseconds from a start that the file gives without a zone, read as UTC."""

import re
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation

from canlog.logs.tables.layout import MILLISECONDS, Column, Layout, Meaning, Role
from canlog.logs.tables.table import Table

DAY_US = 86_400_000_000
DAYS_TO_EPOCH = 25_569  # from 1899-12-30 to 1970-01-01
MOST_DAYS = 120_000
STANDARD_DIGITS = 4

VERSION = re.compile(rb";\$FILEVERSION\s*=\s*(\d\.\d)", re.IGNORECASE)
START_DAYS = re.compile(rb";\$STARTTIME\s*=\s*([\d.]{1,40})", re.IGNORECASE)
COLUMNS = re.compile(rb";\$COLUMNS\s*=\s*([A-Za-z,\s]+)", re.IGNORECASE)
UNKNOWN_DATE = re.compile(rb";\s*Start time:\s*\S")
START_DATE = re.compile(rb";\s*Start time:\s*(\d+)\.(\d+)\.(\d{4})\s+(\d+):(\d+):(\d+)(?:\.(\d{1,3}))?")

_NUMBER = Column(role=Role.IGNORED)
_TIME = Column(role=Role.TIME, parameter=MILLISECONDS)
_BUS = Column(role=Role.CHANNEL)
_ID = Column(role=Role.ID, parameter=STANDARD_DIGITS)
_TYPE = Column(role=Role.WORD)
_RESERVED = Column(role=Role.IGNORED)
_LENGTH = Column(role=Role.LENGTH_CODE)
_DATA = Column(role=Role.DATA)

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
# By the letters that ``$COLUMNS`` has for them.
NEW_COLUMNS = {
    "N": _NUMBER,
    "O": _TIME,
    "T": _TYPE,
    "B": _BUS,
    "I": _ID,
    "d": Column(role=Role.DIRECTION),
    "R": _RESERVED,
    "l": Column(role=Role.LENGTH),
    "L": _LENGTH,
    "D": _DATA,
}
NEEDED_COLUMNS = {"O", "T", "I"}


def _old(*columns: Column) -> Layout:
    return Layout(columns=(_NUMBER, _TIME, *columns, _LENGTH, _DATA), words=OLD_WORDS, comment_starts=b";")


def _new(letters: str) -> Layout:
    columns = tuple(NEW_COLUMNS[letter] for letter in letters)
    return Layout(columns=columns, words=NEW_WORDS, comment_starts=b";")


LAYOUTS = {
    b"1.0": _old(_ID),
    b"1.1": _old(_TYPE, _ID),
    b"1.2": _old(_BUS, _TYPE, _ID),
    b"1.3": _old(_BUS, _TYPE, _ID, _RESERVED),
    b"2.0": _new("NOTIdlD"),
    b"2.1": _new("NOTBIdRLD"),
}


class Trc(Table):
    """The trace of PCAN-View and PCAN-Explorer; without a version it is 1.0."""

    def __init__(self) -> None:
        super().__init__(LAYOUTS[b"1.0"])
        self._has_start = False

    def read_comment(self, line: bytes) -> bool:
        """Take up what a line without a frame says; return whether it belongs to the format."""
        if version := VERSION.match(line):
            self.layout = LAYOUTS.get(version[1], self.layout)
            return version[1] in LAYOUTS
        if columns := COLUMNS.match(line):
            return self._take_columns(columns[1])
        if days := START_DAYS.match(line):
            return self._take_start(_days_us(days[1]))
        if (date := START_DATE.match(line)) and not self._has_start:
            return self._take_start(_date_us(date))
        if UNKNOWN_DATE.match(line) and not self._has_start:
            self.notes.append("the start time of the log is not understood: times count from 1970")
        return True

    def _take_columns(self, listed: bytes) -> bool:
        letters = "".join(listed.decode("ascii").replace(",", " ").split())
        is_usable = set(letters) >= NEEDED_COLUMNS and set(letters) <= NEW_COLUMNS.keys() and len(letters) < 16
        if is_usable:
            self.layout = _new(letters)
        return is_usable

    def _take_start(self, start_us: int | None) -> bool:
        if start_us is None:
            return False
        self.set_clock(start_us)
        self._has_start = True
        return True


def _days_us(text: bytes) -> int | None:
    """Return days since 1899-12-30 as microseconds since the epoch; None if they are none, or before it."""
    try:
        days = Decimal(text.decode("ascii"))
    except InvalidOperation:
        return None
    if not DAYS_TO_EPOCH <= days <= MOST_DAYS:
        return None
    return round((days - DAYS_TO_EPOCH) * DAY_US)


def _date_us(found: re.Match[bytes]) -> int | None:
    """Return ``11.09.2002 16:00:20.682`` in microseconds since the epoch; None if there is no such time."""
    day, month, year, hour, minute, second = (int(found[number]) for number in range(1, 7))
    try:
        start = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    return int(start.timestamp()) * 1_000_000 + int((found[7] or b"0").ljust(3, b"0")) * 1_000
