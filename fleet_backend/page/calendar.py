"""Days as a calendar (iCalendar, RFC 5545): as much of it as an entry of a whole day needs."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from typing import Final

_LONGEST: Final = 75  # bytes of a line, its end not counted
_ESCAPED: Final = str.maketrans({"\\": "\\\\", ";": "\\;", ",": "\\,", "\n": "\\n", "\r": ""})


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """Something on one day; of the same key in a later calendar it takes the place."""

    key: str
    day: date
    title: str
    text: str


def calendar_of(name: str, entries: Iterable[Entry], now: datetime) -> bytes:
    return "".join(_folded(line) for line in _lines(name, entries, now)).encode()


def _lines(name: str, entries: Iterable[Entry], now: datetime) -> Iterator[str]:
    yield from ("BEGIN:VCALENDAR", "VERSION:2.0", "PRODID:-//clutchdiag//fleet//EN", "CALSCALE:GREGORIAN")
    yield f"X-WR-CALNAME:{name.translate(_ESCAPED)}"
    for one in entries:
        yield from ("BEGIN:VEVENT", f"UID:{one.key.translate(_ESCAPED)}")
        yield f"DTSTAMP:{now.astimezone(UTC):%Y%m%dT%H%M%SZ}"
        yield f"DTSTART;VALUE=DATE:{one.day:%Y%m%d}"
        yield f"DTEND;VALUE=DATE:{one.day + timedelta(days=1):%Y%m%d}"
        yield f"SUMMARY:{one.title.translate(_ESCAPED)}"
        yield f"DESCRIPTION:{one.text.translate(_ESCAPED)}"
        yield from ("TRANSP:TRANSPARENT", "END:VEVENT")
    yield "END:VCALENDAR"


def _folded(line: str) -> str:
    """Return a line in pieces of 75 bytes at most; no character is cut."""
    pieces, size = [""], 0
    for character in line:
        width = len(character.encode())
        if size + width > _LONGEST:
            pieces.append(" ")
            size = 1
        pieces[-1] += character
        size += width
    return "\r\n".join(pieces) + "\r\n"
