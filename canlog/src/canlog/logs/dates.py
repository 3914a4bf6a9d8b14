"""Dates in words as programs of all languages write them into the heads of logs."""

import re
import unicodedata
from collections.abc import Mapping
from datetime import UTC, datetime, timezone

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
