"""PCAN trace files, versions 1.0 to 2.1: milliseconds from a start that the file gives without a zone, read as UTC."""

import re
from collections.abc import Mapping
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation

from canlog.logs.columns.log import TableLog
from canlog.logs.columns.roles import BLANKS, HEXADECIMAL, MILLISECONDS, Column, Layout, Meaning, Role

DAY_US = 86_400_000_000
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
    "N": Column(role=Role.IGNORED),
    "O": Column(role=Role.TIME, parameter=MILLISECONDS),
    "T": Column(role=Role.WORD),
    "B": Column(role=Role.CHANNEL),
    "I": Column(role=Role.ID, parameter=HEXADECIMAL),
    "d": Column(role=Role.DIRECTION),
    "R": Column(role=Role.IGNORED),  # reserved
    "l": Column(role=Role.LENGTH),
    "L": Column(role=Role.LENGTH_CODE),
    "D": Column(role=Role.DATA, parameter=HEXADECIMAL),
}
NEEDED_LETTERS, MOST_LETTERS = set("OTI"), 15


def layout_of(letters: str, words: Mapping[str, Meaning]) -> Layout:
    return Layout(
        columns=tuple(COLUMN_OF_LETTER[one] for one in letters),
        separator=BLANKS,
        extended_digits=STANDARD_DIGITS + 1,
        words=words,
        comment_starts=b";",
        is_exact=True,
    )


LAYOUTS = {
    b"1.0": layout_of("NOILD", OLD_WORDS),
    b"1.1": layout_of("NOTILD", OLD_WORDS),
    b"1.2": layout_of("NOBTILD", OLD_WORDS),
    b"1.3": layout_of("NOBTIRLD", OLD_WORDS),
    b"2.0": layout_of("NOTIdlD", NEW_WORDS),
    b"2.1": layout_of("NOTBIdRLD", NEW_WORDS),
}


class Trc(TableLog):
    """The trace of PCAN-View and PCAN-Explorer; without a version it is 1.0."""

    def __init__(self) -> None:
        super().__init__(LAYOUTS[b"1.0"])
        self._has_start = False

    def read_comment(self, line: bytes) -> bool:
        """Take up what a line without a frame says; return whether it belongs to the format."""
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
            self.set_layout(layout_of(letters, NEW_WORDS))
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


def _date_us(found: re.Match[bytes]) -> int | None:
    """Return ``11.09.2002 16:00:20.682`` in microseconds since the epoch; None if there is no such time."""
    day, month, year, hour, minute, second = (int(found[number]) for number in range(1, 7))
    try:
        start = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    return int(start.timestamp()) * 1_000_000 + int((found[7] or b"0").ljust(3, b"0")) * 1_000
