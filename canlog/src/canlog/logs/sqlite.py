"""SQLite logs of python-can: a table ``messages`` with seconds since the epoch, UTC; CAN FD is told by its length only.

The file is opened for reading, and only a plain table is read: a view could run for ever.
"""

import math
import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import BinaryIO

from canlog.errors import SourceError
from canlog.frames import (
    ERROR_FLAG,
    EXTENDED_FLAG,
    FD_FLAG,
    FD_PAYLOAD_BYTES,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    Frame,
    FrameBatch,
    batch_of,
)
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.text_kernels import IS_LENGTH

MAGIC = b"SQLite format 3\0"
ROWS_PER_BATCH = 65_536
LONGEST_VALUE = 1_000_000  # bytes of a text or blob
LEAST_ROW_BYTES = 4  # a damaged tree may lead to its rows again and again
LAST_S = 9.2e9
US_PER_S, NS_PER_US = 1e6, 1_000
MAX_STANDARD_ID, MAX_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF
QUERY = "SELECT ts, arbitration_id, extended, remote, error, dlc, data FROM messages"

Row = tuple[object, ...]


def read_sqlite(stream: BinaryIO, counts: LogCounts) -> Iterator[FrameBatch]:
    """Yield the frames of a database in the order of its rows.

    Raises SourceError if it has no table of messages that can be read.
    """
    most_rows = Path(stream.name).stat().st_size // LEAST_ROW_BYTES
    try:
        with closing(_opened(stream)) as database:
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST_VALUE)
            database.text_factory = bytes
            cursor = _messages(database)
            yield from _batches(cursor, most_rows, counts)
    except sqlite3.Error as exc:
        raise SourceError(f"the SQLite file cannot be read: {exc}") from exc


def check_messages(stream: BinaryIO) -> None:
    """Raise SourceError if a database is sound and no log; damage is found when it is read."""
    with suppress(sqlite3.Error), closing(_opened(stream)) as database:
        database.text_factory = bytes
        _messages(database)


def _opened(stream: BinaryIO) -> sqlite3.Connection:
    return sqlite3.connect(f"{Path(stream.name).resolve().as_uri()}?mode=ro", uri=True)


def _messages(database: sqlite3.Connection) -> sqlite3.Cursor:
    kind = database.execute("SELECT type FROM sqlite_master WHERE name = 'messages'").fetchone()
    if kind is None or kind[0] != b"table":
        raise SourceError("the SQLite file has no table of messages as python-can writes it")
    return database.execute(QUERY)


def _batches(cursor: sqlite3.Cursor, most_rows: int, counts: LogCounts) -> Iterator[FrameBatch]:
    number, is_over = 0, False
    while not is_over:
        frames: list[Frame] = []
        try:
            while len(frames) < ROWS_PER_BATCH and not (is_over := (row := cursor.fetchone()) is None):
                number += 1
                frame = frame_of(row)
                if frame is None:
                    counts.reject(LogReject.MALFORMED, f"row {number}")
                else:
                    frames.append(frame)
                if number > most_rows:
                    raise sqlite3.DatabaseError("more rows than the file can hold")
        except (sqlite3.Error, MemoryError):  # of a cell that states more bytes than there can be
            counts.truncated = is_over = True
            counts.reject(LogReject.DAMAGED, f"row {number + 1}")
        if frames:
            counts.frames += len(frames)
            yield batch_of(frames)


def frame_of(row: Row) -> Frame | None:
    """Return the frame of a row, None if its values make none."""
    time_s, can_id, is_extended, is_remote, is_error, length, data = row
    t_ns = time_ns(time_s)
    if t_ns is None or is_error:
        return None if t_ns is None else Frame(t_ns, ERROR_FLAG, 0, b"")
    if not isinstance(can_id, int) or not 0 <= can_id <= (MAX_EXTENDED_ID if is_extended else MAX_STANDARD_ID):
        return None
    if not isinstance(length, int) or not 0 <= length <= FD_PAYLOAD_BYTES or not IS_LENGTH[length]:
        return None
    flagged = can_id | (EXTENDED_FLAG if is_extended else 0)
    if is_remote:
        return Frame(t_ns, flagged | REMOTE_FLAG, length, b"") if length <= PAYLOAD_BYTES else None
    payload = b"" if data is None else data
    if not isinstance(payload, bytes) or len(payload) != length:
        return None
    return Frame(t_ns, flagged, length, payload, FD_FLAG if length > PAYLOAD_BYTES else 0)


def time_ns(time_s: object) -> int | None:
    """Return a time in nanoseconds, whole microseconds; None if there can be no such time."""
    if not isinstance(time_s, float | int) or not math.isfinite(time_s) or not 0 <= time_s < LAST_S:
        return None
    return round(time_s * US_PER_S) * NS_PER_US
