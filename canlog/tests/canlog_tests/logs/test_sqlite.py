"""SQLite logs: rows of python-can's table, and databases that are none or a trap."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from canlog.errors import SourceError
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, join
from canlog.logs import LogReject, read_log

TABLE = "CREATE TABLE messages (ts, arbitration_id, extended, remote, error, dlc, data)"
ENDLESS_VIEW = (
    "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (VALUES(0) UNION ALL SELECT i + 1 FROM n) SELECT i AS ts,"
    " 1 AS arbitration_id, 0 AS extended, 0 AS remote, 0 AS error, 0 AS dlc, '' AS data FROM n"
)
GOOD = (1.5, 0x123, 0, 0, 0, 2, b"\x01\x02")


def database(path: Path, *rows: tuple[object, ...], table: str = TABLE) -> Path:
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(table)
        connection.executemany("INSERT INTO messages VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
        connection.commit()
    return path


def test_kinds_of_frames(tmp_path: Path) -> None:
    path = database(
        tmp_path / "drive.db",
        GOOD,
        (2, 0x7FF, 0, 1, 0, 8, None),
        (3.0, 0, 0, 0, 1, 8, bytes(8)),
        (4.0, 5, 1, 0, 0, 12, bytes(range(12))),
    )
    batch = join(list(read_log(path)))
    assert batch.can_id.tolist() == [0x123, 0x7FF | REMOTE_FLAG, ERROR_FLAG, 5 | EXTENDED_FLAG]
    assert batch.length.tolist() == [2, 8, 0, 12]
    assert batch.flags.tolist() == [0, 0, 0, FD_FLAG]
    assert batch.data[3].tobytes() == bytes(range(12)).ljust(64, b"\0")


@pytest.mark.parametrize(
    "row",
    [
        ("yesterday", 1, 0, 0, 0, 1, b"\x01"),
        (float("inf"), 1, 0, 0, 0, 1, b"\x01"),
        (-1.0, 1, 0, 0, 0, 1, b"\x01"),
        (1.0, 0x800, 0, 0, 0, 1, b"\x01"),
        (1.0, -1, 1, 0, 0, 1, b"\x01"),
        (1.0, "1", 0, 0, 0, 1, b"\x01"),
        (1.0, 1, 0, 0, 0, 2, b"\x01"),
        (1.0, 1, 0, 0, 0, 9, bytes(9)),
        (1.0, 1, 0, 1, 0, 12, None),
        (None, None, None, None, None, None, None),
    ],
)
def test_a_row_that_is_no_frame_is_counted_with_its_number(row: tuple[object, ...], tmp_path: Path) -> None:
    reader = read_log(database(tmp_path / "drive.db", GOOD, row, GOOD))
    assert sum(len(batch) for batch in reader) == 2
    assert reader.counts.rejected == {LogReject.MALFORMED: 1}
    assert reader.counts.first_rejected == "row 2: malformed"


@pytest.mark.parametrize("statement", ["CREATE TABLE frames (t)", ENDLESS_VIEW, "CREATE TABLE messages (t)"])
def test_a_database_without_the_table_is_one_clear_error(statement: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.db"
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(statement)
        connection.commit()
    with pytest.raises(SourceError, match="SQLite"):
        list(read_log(path))
