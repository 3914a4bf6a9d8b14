"""Dates and times of day, as programs of all languages write them into the heads of logs and into cells of tables."""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timezone
from itertools import pairwise
from typing import NamedTuple

US_PER_S, US_PER_MS = 1_000_000, 1_000
US_PER_DAY = 86_400 * US_PER_S
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
MONTH_OF_STEM: Mapping[str, int] = {stem: number for number, stems in enumerate(_STEMS, 1) for stem in stems.split()}
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

TIME_OF_DAY = re.compile(
    r"(?:(?P<days>\d+)\s+)?(?P<hour>\d{1,2}):(?P<minute>\d\d):(?P<second>\d\d)(?:[.,:](?P<fraction>\d{1,9}))?"
    r"(?:\s*(?P<half>[ap])\.?\s?m\.?)?",
    re.IGNORECASE,
)
TO_THE_MINUTE = re.compile(r"(?P<hour>\d{1,2}):(?P<minute>\d\d)(?:\s*(?P<half>[ap])\.?\s?m\.?)?", re.IGNORECASE)
CELL_DAY = re.compile(
    r"(?:(?P<year>\d{4})(?P<mark>[-/.])(?P<month>\d\d?)(?P=mark)(?P<day>\d\d?)"
    r"|(?P<first>\d\d?)(?P<between>[-/.])(?P<second>\d\d?)(?P=between)(?P<last>\d{4}|\d\d)"
    r"|(?P<of>\d\d?)(?:-|\.? )(?P<word>[^\W\d_]{3,9})(?:-|\.? )(?P<in>\d{4}))"
    r"(?:[ T,]+(?P<time>\S.*))?",
    re.DOTALL,
)
CENTURY, FIRST_YEAR = 2000, 70  # of years of two digits


def date_us(text: bytes) -> int | None:
    """Return a date such as ``Thu Jan  1 10:00:00.005 am 2026`` in microseconds since the epoch, None if it is none.

    Local time, unless it says UTC. Up to three digits behind the seconds count milliseconds: python-can writes
    5 ms as ``.5``. Of numbers the day is the first, unless that is the year; between slashes it is the one that can be
    no month: ``3/4/2026`` may be two days and is none.
    """
    folded = _folded(text)
    without_day = folded  # in numbers, whose colons are not those of a time
    for pattern in (DAY_FIRST, YEAR_FIRST):
        without_day = pattern.sub(lambda date: " " * len(date[0]), without_day)
    clock = CLOCK.search(without_day)
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
    digits = clock["fraction"] or "0"
    fraction_us = int(digits) * US_PER_MS if len(digits) <= MILLISECOND_DIGITS else int(digits.ljust(6, "0")[:6])
    return None if start_s is None else start_s * US_PER_S + fraction_us


class Moment(NamedTuple):
    """What a cell says: microseconds since 1970 in UTC, or since midnight."""

    us: float
    is_date: bool  # or a time with the days that have passed before it


def moment_of(cell: str, *, is_month_first: bool = False) -> Moment | None:
    """Return a date, with its time of day or without, or a time of day; None if it is neither. No zone means UTC.

    ``is_month_first`` says what is the first number of a date between slashes, such as ``3/4/2026``.
    """
    text = cell.strip()
    if (time := TIME_OF_DAY.fullmatch(text)) is not None:
        time_us = _time_of_day_us(time)
        return None if time_us is None else Moment(time_us, is_date=time["days"] is not None)
    if text[4:5] in {"-", "/"} and (moment := _iso_moment(text)) is not None:
        return moment
    found = CELL_DAY.fullmatch(text)
    day = None if found is None else _cell_day(found, is_month_first=is_month_first)
    start_us = None if day is None else _day_us(day)
    if found is None or start_us is None:
        return None
    rest = (found["time"] or "").strip()
    if not rest:
        return Moment(start_us, is_date=True)
    time = TIME_OF_DAY.fullmatch(rest) or TO_THE_MINUTE.fullmatch(rest)
    time_us = None if time is None else _time_of_day_us(time)
    return None if time_us is None else Moment(start_us + time_us, is_date=True)


def is_moment(cell: str) -> bool:
    """Return whether a cell is a date or a time of day, whichever of day and month is first."""
    return any(moment_of(cell, is_month_first=is_first) is not None for is_first in (False, True))


def is_day(cell: str) -> bool:
    """Return whether a cell is a date without a time of day."""
    found = CELL_DAY.fullmatch(cell.strip())
    return found is not None and not found["time"] and _cell_day(found, is_month_first=False) is not None


def is_month_first(cells: Sequence[str]) -> tuple[bool, tuple[str, ...]]:
    """Return whether months stand before days in dates between slashes, and what had to be assumed.

    A number above twelve shows it, or that only one of both orders puts neighbours on the same day or the next one, or
    AM and PM, which the same people write; else whether numbers have leading zeros.
    """
    found = [(cell, day) for cell in cells if (day := CELL_DAY.fullmatch(cell.strip())) and day["between"] == "/"]
    pairs = {(int(day["first"]), int(day["second"])) for _, day in found}
    if any(first > MOST_MONTHS for first, _ in pairs) or all(first == second for first, second in pairs):
        return False, ()
    if any(second > MOST_MONTHS for _, second in pairs):
        return True, ()
    near = [_are_near(found, is_month_first=is_first) for is_first in (False, True)]
    if near[0] != near[1]:
        return near[1], ()
    if any(HALF.search(cell.casefold()) for cell, _ in found):
        return True, ()
    is_padded = any(day["first"].startswith("0") or day["second"].startswith("0") for _, day in found)
    order = "day" if is_padded else "month"
    note = f"{found[0][0]} is taken as a date with the {order} first: no number in it is above 12"
    return not is_padded, (note,)


def _are_near(found: Sequence[tuple[str, re.Match[str]]], *, is_month_first: bool) -> bool:
    """Return whether each date is that of the one before it or of the day behind that."""
    days = dict.fromkeys(_cell_day(day, is_month_first=is_month_first) for _, day in found)
    starts = [None if day is None else _day_us(day) for day in days]
    return all(
        before is not None and after is not None and 0.0 <= after - before <= US_PER_DAY
        for before, after in pairwise(starts)
    )


def _iso_moment(text: str) -> Moment | None:
    """Return a date of ISO 8601, perhaps with a zone."""
    try:
        moment = datetime.fromisoformat(text.replace("/", "-").replace(",", "."))
    except ValueError:
        return None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return Moment((moment - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds() * US_PER_S, is_date=True)


def _time_of_day_us(time: re.Match[str]) -> float | None:
    parts = time.groupdict()
    hour = _hour(int(parts["hour"]), None if parts["half"] is None else parts["half"] in "pP")
    if hour is None:
        return None
    fraction = float(f"0.{parts['fraction']}") if parts.get("fraction") else 0.0
    days, second = int(parts.get("days") or 0), int(parts.get("second") or 0)
    return (((days * 24 + hour) * 60 + int(parts["minute"])) * 60 + second + fraction) * US_PER_S


def _cell_day(found: re.Match[str], *, is_month_first: bool) -> Day | None:
    """Return the day that a cell tells; None if it names no month."""
    if found["year"]:
        return int(found["year"]), int(found["month"]), int(found["day"])
    if found["word"]:
        month = month_of(_folded(found["word"].encode()))
        return None if month is None else (int(found["in"]), month, int(found["of"]))
    year = int(found["last"])
    year += (CENTURY if year < FIRST_YEAR else CENTURY - 100) if len(found["last"]) == len("26") else 0
    first, second = int(found["first"]), int(found["second"])
    is_swapped = found["between"] == "/" and is_month_first
    return (year, first, second) if is_swapped else (year, second, first)


def _day_us(day: Day) -> float | None:
    try:
        return (datetime(*day, tzinfo=UTC) - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds() * US_PER_S
    except ValueError:
        return None


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


def _numbered_day(rest: str) -> Day | None:
    match = YEAR_FIRST.search(rest) or DAY_FIRST.search(rest)
    if match:
        return int(match["year"]), int(match["month"]), int(match["day"])
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


def _epoch_s(day: Day, hour: int, minute: int, second: int, zone: timezone | None) -> int | None:
    """Return seconds since the epoch, None if there is no such time or it lies before."""
    try:
        start_s = int(datetime(*day, hour, minute, second, tzinfo=zone).timestamp())
    except (ValueError, OverflowError, OSError):  # the last two: of the C library, in the year 1
        return None
    return start_s if start_s >= 0 else None
