"""Vector ASC logs to columns: what its header lines say, and the lines that they speak of.

Times are read as whole microseconds (further digits are rounded) and added to the start of the measurement. The file
gives that in local time without a zone, to the millisecond; python-can reads it in the same way.
"""

import re
import unicodedata
from collections.abc import Mapping
from datetime import UTC, datetime, timezone
from types import MappingProxyType

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import FD_FLAG, FrameBatch
from canlog.logs.asc_kernel import BASE, CLOCK_FIELDS, DECIMAL, HEXADECIMAL, IS_RELATIVE, NOW_US, START_US, parse_lines
from canlog.logs.frame_buffer import FrameRows
from canlog.logs.text_log import TextLog

LONGEST_SHOWN = 60  # bytes of a date

HEADER = re.compile(rb"(?:date|base|no\s+internal|internal|begin|end|previous|split)\b|//", re.IGNORECASE)
START = re.compile(rb"(?:date|begin\s+triggerblock)\s+(?P<date>\S.*)", re.IGNORECASE)
BASE_LINE = re.compile(rb"base\s+(?P<base>hex|dec)(?:\s+timestamps\s+(?P<kind>absolute|relative))?", re.IGNORECASE)
FIRST_LINE = re.compile(rb"base\s+(?:hex|dec)|(?:date|begin\s+triggerblock)\s+\S", re.IGNORECASE)
WHOLE_BYTE_AT_END = re.compile(rb"\s[0-9a-f]{2}\s*$", re.IGNORECASE)
US_PER_S, US_PER_MS = 1_000_000, 1_000
LONGEST_DATE = 100
MILLISECOND_DIGITS = 3
HALF_DAY_HOURS = 12

# Beginnings of the months' names, without accents and in small letters; the longest that fits a word decides.
_STEMS = (
    "jan ian gen ene sty led oca tammi янв",
    "feb fev lut uno sub helmi фев",
    "mar mrz mrt maerz bre maalis мар",
    "apr avr abr kwi dub nis huhti апр",
    "mai may mag mei maj kve touko май мая",
    "jun juin iun giu cze cvn cerven haz kesa июн",
    "jul juil iul lug lip cvc cervenec tem heina июл",
    "aug aou ago sie srp agu elo авг",  # codespell:ignore
    "sep set szept wrz zar eyl syys сен",  # codespell:ignore
    "oct okt ott out paz rij eki loka окт",
    "nov noi lis kas marras ноя",
    "dec dez dic des gru pro ara joulu дек",
)
MONTH_OF_STEM: Mapping[str, int] = MappingProxyType(
    {stem: number for number, stems in enumerate(_STEMS, 1) for stem in stems.split()}
)
ZONES_OF_UTC = {"utc", "gmt", "z"}
MOST_MONTHS = 12
MOST_OTHER_WORDS = 1  # the day of the week

CLOCK = re.compile(r"(?<!\d)(?P<hour>\d{1,2}):(?P<minute>\d\d?):(?P<second>\d\d?)(?:[.:,](?P<fraction>\d{1,9}))?(?!\d)")
HALF = re.compile(r"(?<!\w)(?:(?P<afternoon>p\.?\s?m\.?|nachm\.?|下午|午後)|a\.?\s?m\.?|vorm\.?|上午|午前)(?!\w)")
YEAR_FIRST = re.compile(r"(?<!\d)(?P<year>\d{4})(?:[-/.]|\s*年)(?P<month>\d\d?)(?:[-/.]|\s*月)(?P<day>\d\d?)日?(?!\d)")
DAY_FIRST = re.compile(r"(?<!\d)(?P<day>\d\d?)(?P<mark>[.:-])(?P<month>\d\d?)(?P=mark)(?P<year>\d{4})(?!\d)")
SLASHED = re.compile(r"(?<!\d)(?P<first>\d\d?)/(?P<second>\d\d?)/(?P<year>\d{4})(?!\d)")
NUMBERED_MONTH = re.compile(r"(?<!\d)(?P<month>\d\d?)\s*[月월]")
NUMBER = re.compile(r"(?<!\d)\d{1,4}(?!\d)")
WORD = re.compile(r"[^\W\d_]+")

Day = tuple[int, int, int]  # year, month, day


def date_us(text: bytes) -> int | None:
    """Return a date such as ``Thu Jan  1 10:00:00.005 am 2026`` in microseconds since the epoch, None if it is none.

    Local time, unless it says UTC. Up to three digits behind the seconds count milliseconds: python-can writes
    5 ms as ``.5``. Of numbers the day is the first, unless that is the year; between slashes it is the one that can be
    no month: ``3/4/2026`` may be two days and is none.
    """
    folded = _folded(text)
    clock = CLOCK.search(_without_day(folded))
    if clock is None or len(text) > LONGEST_DATE:
        return None
    rest = folded.replace(clock[0], " ", 1)
    half = HALF.search(rest)
    if half is not None:
        rest = rest[: half.start()] + " " + rest[half.end() :]
    day = _numbered_day(rest) or _named_day(rest)
    hour = _hour(int(clock["hour"]), None if half is None else bool(half["afternoon"]))
    if day is None or hour is None:
        return None
    words = [word for word in WORD.findall(rest) if month_of(word) is None and word not in {"年", "月", "日", "t"}]
    zone = UTC if ZONES_OF_UTC & set(words) else None
    if len([word for word in words if word not in ZONES_OF_UTC]) > MOST_OTHER_WORDS:
        return None
    start_s = _epoch_s(day, hour, int(clock["minute"]), int(clock["second"]), zone)
    return None if start_s is None else start_s * US_PER_S + _fraction_us(clock["fraction"] or "")


def local_midnight_us(time_us: int) -> int:
    """Return the beginning of the day, in local time, of a time since the epoch."""
    local = datetime.fromtimestamp(time_us // US_PER_S)  # noqa: DTZ006 - local, as the logs mean it
    return max(0, int(local.replace(hour=0, minute=0, second=0).timestamp())) * US_PER_S


def month_of(word: str) -> int | None:
    """Return the number of the month that a word names, folded as here, None if it names none."""
    known = (word[:length] for length in range(len(word), 2, -1))
    return next((MONTH_OF_STEM[stem] for stem in known if stem in MONTH_OF_STEM), None)


def decoded(text: bytes) -> str:
    """Return text of either encoding that is in use."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")


def _folded(text: bytes) -> str:
    """Return a date in small letters, without accents and without the comment that may follow it."""
    spelled = decoded(text[: LONGEST_DATE + 1]).partition("//")[0].casefold()
    apart = unicodedata.normalize("NFKD", spelled.replace("й", "\0"))
    return "".join(character for character in apart if not unicodedata.combining(character)).replace("\0", "й")


def _without_day(folded: str) -> str:
    """Return a date with a blank for the day in numbers, whose colons are not those of a time."""
    for pattern in (DAY_FIRST, YEAR_FIRST):
        folded = pattern.sub(lambda found: " " * len(found[0]), folded)
    return folded


def _numbered_day(rest: str) -> Day | None:
    found = YEAR_FIRST.search(rest) or DAY_FIRST.search(rest)
    if found:
        return int(found["year"]), int(found["month"]), int(found["day"])
    slashed = SLASHED.search(rest)
    month, day = sorted(map(int, slashed.group("first", "second"))) if slashed else (0, 0)
    return (int(slashed["year"]), month, day) if slashed and (day > MOST_MONTHS or day == month) else None


def _named_day(rest: str) -> Day | None:
    """Return the day of a date that names its month; of two such words the first is the day of the week."""
    numbered = NUMBERED_MONTH.search(rest)
    if numbered is not None:
        rest = rest.replace(numbered[0], " ", 1)
    months = [number for word in WORD.findall(rest) if (number := month_of(word)) is not None]
    numbers = NUMBER.findall(rest)
    years = [text for text in numbers if len(text) == len("2026")]
    days = [text for text in numbers if len(text) <= len("31")]
    if not (months or numbered) or len(years) != 1 or len(days) != 1 or "/" in rest:
        return None
    return int(years[0]), int(numbered["month"]) if numbered else months[-1], int(days[0])


def _hour(hour: int, is_afternoon: bool | None) -> int | None:  # noqa: FBT001 - None: the clock has 24 hours
    """Return the hour of the day; some programs write ``pm`` behind hours of 24, too."""
    if is_afternoon is None:
        return hour
    if hour > HALF_DAY_HOURS:
        return hour if is_afternoon else None
    return hour % HALF_DAY_HOURS + HALF_DAY_HOURS * is_afternoon


def _fraction_us(digits: str) -> int:
    if len(digits) <= MILLISECOND_DIGITS:
        return int(digits or 0) * US_PER_MS
    return int(digits.ljust(6, "0")[:6])


def _epoch_s(day: Day, hour: int, minute: int, second: int, zone: timezone | None) -> int | None:
    """Return seconds since the epoch, None if there is no such time or it lies before."""
    try:
        start_s = int(datetime(*day, hour, minute, second, tzinfo=zone).timestamp())
    except (ValueError, OverflowError, OSError):  # the last two: what the C library says of the year 1
        return None
    return start_s if start_s >= 0 else None


class AscLog(TextLog):
    """A log of Vector's tools; its header says in which base numbers are, and what times count from."""

    shortest_line_bytes = 13  # "0.0 1 1 Rx r"

    def __init__(self) -> None:
        super().__init__()
        self._clock = np.zeros(CLOCK_FIELDS, np.int64)
        self._clock[BASE] = HEXADECIMAL

    def parse(self, text: UInt8Array, rows: FrameRows, progress: Int64Array) -> None:
        """Read lines up to one of a header."""
        parse_lines(text, rows, self._clock, progress)

    def read_comment(self, line: bytes) -> bool:
        """Take up what a header line says; return whether it is one."""
        if line and not HEADER.match(line):
            return False
        if base := BASE_LINE.match(line):
            self._clock[BASE] = DECIMAL if base["base"].lower() == b"dec" else HEXADECIMAL
            self._clock[IS_RELATIVE] = (base["kind"] or b"").lower() == b"relative"
        elif start := START.match(line):
            self._set_start(start["date"])
        return True

    def is_whole(self, line: bytes, frame: FrameBatch) -> bool:
        """Return whether the line ends with a whole byte; behind those of a CANFD line are other numbers."""
        is_byte = self._clock[BASE] == HEXADECIMAL and WHOLE_BYTE_AT_END.search(line) is not None
        return is_byte and not frame.flags[0] & FD_FLAG

    def _set_start(self, date: bytes) -> None:
        start_us = date_us(date)
        self._clock[NOW_US] = 0
        if start_us is not None:
            self._clock[START_US] = start_us
        elif not self._clock[START_US]:
            shown = decoded(date[:LONGEST_SHOWN]).encode("ascii", "backslashreplace").decode()
            self.notes.append(f"the date {shown!r} is not understood: times count from 1970")


def is_asc_header(line: bytes) -> bool:
    """Return whether a line is one of those an ASC file begins with."""
    start = START.match(line)
    return bool(BASE_LINE.match(line)) or (start is not None and date_us(start["date"]) is not None)
