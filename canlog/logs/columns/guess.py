"""What the columns of a table may be by what stands in them, to be proposed where names do not tell; never taken."""

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from canlog.frames import FrameBatch
from canlog.logs.columns.header import (
    LARGEST_ID,
    LARGEST_STANDARD_ID,
    ROLE_OF_NAME,
    named_columns,
    names_in,
    separator_of,
)
from canlog.logs.columns.roles import Role

SAMPLE_LINES: Final = 100
LEAST_ROWS, LEAST_COLUMNS = 3, 2
LEAST_RISING: Final = 0.9  # of all steps of a clock; a few may fall where it begins again
MOST_STANDING: Final = 0.5  # of all steps of a clock
SHORTEST_ID_DIGITS: Final = 2
LEAST_EXTENDED_ID: Final = 0x10_0000  # those of 29 bits begin with a priority: none that is in use is smaller
LEAST_FITTING, FEW_IDS = 0.9, 3  # of identifiers
COMMENTS: Final = b"#"
NUMBER: Final = re.compile(r"[+-]?\d+(?:[.,]\d*)?(?:[eE][+-]?\d+)?")
CLOCK: Final = re.compile(r"(?:\d{4}[-/]\d\d[-/]\d\d[ T])?\d{1,2}:\d\d:\d\d(?:[.,:]\d+)?\S*")
IDENTIFIER: Final = re.compile(r"(?:0x)?([0-9A-Fa-f]{1,10})[xh]?", re.IGNORECASE)
BYTES: Final = re.compile(r"(?:0x)?[0-9A-Fa-f]{2}(?:[\s:._-]*(?:0x)?[0-9A-Fa-f]{2}){0,63}")
LENGTH: Final = re.compile(r"[0-9]|[1-5][0-9]|6[0-4]")
BYTE: Final = re.compile(r"(?:0x)?[0-9A-Fa-f]{2}")
Rows = Sequence[tuple[str, ...]]
Cells = Sequence[Sequence[str]]  # of each column, those that are not empty


def guessed(text: bytes) -> str:
    """Return what ``--columns`` might be told of a text; empty if nothing in it looks like identifiers and bytes."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith(COMMENTS)]
    if len(lines) < LEAST_ROWS:
        return ""
    separator = separator_of(lines[len(lines) // 2])
    split = [names_in(line, separator) for line in lines[: SAMPLE_LINES + 1]]
    has_header = bool(split[0]) and not any(NUMBER.fullmatch(cell) for cell in split[0])
    names, rows = (split[0], split[1:]) if has_header else ((), split)
    width = max(map(len, rows), default=0)
    if width < LEAST_COLUMNS or len(rows) < LEAST_ROWS:
        return ""
    return _in_words(_roles(names, rows, width), names)


def is_traffic(batch: FrameBatch) -> bool:
    """Return whether frames may be those of a bus: identifiers of 11 bits or of 29, that come again."""
    can_ids = np.unique(batch.can_id & np.uint32(LARGEST_ID))
    are_fitting = (can_ids <= LARGEST_STANDARD_ID) | (can_ids >= LEAST_EXTENDED_ID)
    return len(can_ids) <= max(FEW_IDS, len(batch) // 2) and bool(np.mean(are_fitting) >= LEAST_FITTING)


def _roles(names: Sequence[str], rows: Rows, width: int) -> dict[str, list[int]]:
    """Return the places of columns by what they are taken for: by their names first, then by what they hold."""
    cells = [[row[place] for row in rows if place < len(row) and row[place]] for place in range(width)]
    spelled = {role: word for word, role in ROLE_OF_NAME.items()}
    found = dict[str, list[int]]()
    for place, column in enumerate(named_columns(names)):
        if column.role in spelled:
            found[spelled[column.role]] = [place]
        elif column.role is Role.BYTE:
            found.setdefault("data", []).append(place)
    free = [place for place in range(width) if not any(place in places for places in found.values())]
    for word, places_of in (
        ("time", _time_places),
        ("data", _data_places),
        ("id", _id_places),
        ("length", _length_places),
    ):
        if word not in found and (places := places_of(cells, free)):
            found[word] = places
            free = [place for place in free if place not in places]
    return found


def _data_places(cells: Cells, free: Sequence[int]) -> list[int]:
    """Return the column that holds several bytes, else the longest row of columns that hold one each."""
    packed = [place for place in free if _all(cells[place], BYTES) and any(len(one) > 2 for one in cells[place])]
    if packed:
        return [max(packed, key=lambda place: (any(" " in one for one in cells[place]), max(map(len, cells[place]))))]
    runs: list[list[int]] = [[]]
    for place in free:
        if not all(BYTE.fullmatch(cell) for cell in cells[place]):
            runs.append([])
        elif runs[-1] and runs[-1][-1] != place - 1:
            runs.append([place])
        else:
            runs[-1].append(place)
    best = max(runs, key=len)
    return best if len(best) >= LEAST_COLUMNS else []


def _time_places(cells: Cells, free: Sequence[int]) -> list[int]:
    """Return the first column of which most values are later than those before them."""
    return next(([place] for place in free if _are_times(cells[place])), [])


def _are_times(cells: Sequence[str]) -> bool:
    if _all(cells, CLOCK):
        return True
    if len(cells) < LEAST_ROWS or not _all(cells, NUMBER):
        return False
    steps = [after - before for before, after in pairwise(float(cell.replace(",", ".")) for cell in cells)]
    is_rising = sum(step >= 0.0 for step in steps) >= LEAST_RISING * len(steps)
    return is_rising and sum(step == 0.0 for step in steps) <= MOST_STANDING * len(steps)


def _id_places(cells: Cells, free: Sequence[int]) -> list[int]:
    """Return the first column whose values may all be identifiers."""
    return next(([place] for place in free if _are_identifiers(cells[place])), [])


def _are_identifiers(cells: Sequence[str]) -> bool:
    digits = [one[1] for cell in cells if (one := IDENTIFIER.fullmatch(cell))]
    is_fitting = len(digits) == len(cells) > 0 and all(len(one) >= SHORTEST_ID_DIGITS for one in digits)
    return is_fitting and all(int(one, 16) <= LARGEST_ID or one.isdigit() for one in digits)


def _length_places(cells: Cells, free: Sequence[int]) -> list[int]:
    """Return the first column whose values may all be lengths."""
    return next(([place] for place in free if _all(cells[place], LENGTH)), [])


def _all(cells: Sequence[str], pattern: re.Pattern[str]) -> bool:
    return bool(cells) and all(pattern.fullmatch(cell) for cell in cells)


def _in_words(found: dict[str, list[int]], names: Sequence[str]) -> str:
    """Return places as ``--columns`` takes them: by names where they are there and clear, else by numbers."""
    if not found.get("id") or not found.get("data") or not (found.get("time") or found.get("length")):
        return ""
    are_clear = len(set(names)) == len(names) and all(name and not set(name) & set(",=:-.") for name in names)
    shown = [name if are_clear else str(place + 1) for place, name in enumerate(names)]
    shown += [
        str(place + 1) for place in range(len(names), 1 + max(max(places) for places in found.values() if places))
    ]
    order = [word for word in ROLE_OF_NAME if found.get(word)]
    spans = {word: [shown[place] for place in (found[word][0], found[word][-1])] for word in order}
    return ",".join(
        f"{word}={first}" if first == last else f"{word}={first}-{last}" for word, (first, last) in spans.items()
    )
