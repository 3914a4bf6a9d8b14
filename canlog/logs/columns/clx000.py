"""Logs of the CLX000 loggers (CL1000, CL2000, CL3000): ``01T022231683;8;7df;02010d5555555555`` behind a header.

A time is written with as many digits as its owner chose, the last of them milliseconds, with whatever between them:
hours, days, months or the year may be missing. The header has the rest, in the logger's own time.
"""

import calendar
import re
from dataclasses import replace
from types import MappingProxyType
from typing import Final

from canlog.logs.asc import date_us
from canlog.logs.columns.header import names_in
from canlog.logs.columns.log import TableLog
from canlog.logs.columns.roles import DAY_US, HEXADECIMAL, MINUTE_US, Column, Layout, Role

SENT: Final = 0x8  # of a frame's type; its lowest bit says that the identifier has 29 bits
ENTRY: Final = re.compile(rb"^# (Value separator|Time): *\"?([^\"\r\n]*)", re.MULTILINE)
CLX000_HEADER: Final = re.compile(rb"# Logger type: (?:CL|CANLogger)")
START: Final = re.compile(r"(\d{4})(\d\d)(\d\d)(\d\d)(\d\d)(\d\d)")
ROLES: Final = MappingProxyType(
    {
        "timestamp": Column(role=Role.STAMP),
        "type": Column(role=Role.FLAGS, parameter=SENT),
        "id": Column(role=Role.ID, parameter=HEXADECIMAL),
        "length": Column(role=Role.LENGTH),
        "data": Column(role=Role.DATA, parameter=HEXADECIMAL),
    }
)  # others are passed over
# Digits of a time up to its days, hours and so on, each with after how long it begins again; 0: as the month is long.
DAYS, HOURS, MINUTES, SECONDS = 11, 9, 7, 5
LAPS_US: Final = MappingProxyType({DAYS: 0, HOURS: DAY_US, MINUTES: 60 * MINUTE_US, SECONDS: MINUTE_US, 3: 1_000_000})
USUAL_NAMES: Final = ("timestamp", "type", "id", "data")
LAYOUT: Final = Layout(columns=tuple(ROLES[name] for name in USUAL_NAMES), separator=ord(";"))
NO_NAMES: Final = "no line names the columns: the default columns of the loggers are assumed"
NO_START: Final = "the header has no start time: times count from 1970"


class Clx000(TableLog):
    """A log of a CLX000."""

    def __init__(self) -> None:
        super().__init__(LAYOUT)

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
        parts = [int(part) for part in found.groups()] if (found := START.match(start)) else []
        is_date = bool(parts) and 1 <= parts[1] <= 12
        if not is_date:
            self.notes.append(NO_START)
        year, month, day, *clock = parts if is_date else (1970, 1, 1, 0, 0, 0)
        digits = len(stamp)
        if digits > DAYS:
            columns = tuple(
                replace(column, parameter=year) if column.role is Role.STAMP else column
                for column in self.layout.columns
            )
            self.set_layout(replace(self.layout, columns=columns))
            local_us = _local_us(year, month, day, *clock)
            self.set_base(local_us - calendar.timegm((year, month, day, *clock)) * 1_000_000 if local_us else 0)
            return
        lap_us = LAPS_US.get(digits, 0) or calendar.monthrange(year, month)[1] * DAY_US
        # What the times have not, is that of the header; what they have, begins at its least.
        kept = [day, *clock][: (DAYS - digits) // 2]
        least = [1, 0, 0, 0][len(kept) :]
        self.set_layout(replace(self.layout, wrap_us=lap_us))
        self.set_base(_local_us(year, month, *kept, *least) or 0)


def _local_us(year: int, month: int, day: int, hour: int, minute: int, second: int) -> int | None:
    """Return a time of a clock on the wall [us]; None if there is no such day."""
    return date_us(b"%d-%02d-%02d %02d:%02d:%02d" % (year, month, day, hour, minute, second))
