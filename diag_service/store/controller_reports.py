"""What controllers said of their trouble codes, in the file of the results: each time that it was something new."""

import sqlite3
from typing import Final

MOST_BYTES: Final = 16 * 2**20  # of them all, unless the store has a budget
_SHARE: Final = 8  # of a budget, one part of so many


def note(
    sql: sqlite3.Connection, vehicle: str, controller: str, said: str, text: str, budget_bytes: int | None
) -> bool:
    """Keep a report, inside a transaction; False if the controller said the same the last time.

    The oldest go when there are too many; the newest stays.

    Parameters
    ----------
    said
        What counts of the report: all but its time.
    text
        The report, as JSON.
    """
    last = sql.execute(
        "SELECT said FROM controller WHERE vehicle = ? AND controller = ? ORDER BY position DESC LIMIT 1",
        (vehicle, controller),
    ).fetchone()
    if last is not None and last[0] == said:
        return False
    sql.execute(
        "INSERT INTO controller (vehicle, controller, said, json) VALUES (?, ?, ?, ?)",
        (vehicle, controller, said, text),
    )
    most_bytes = MOST_BYTES if budget_bytes is None else budget_bytes // _SHARE
    sql.execute(
        "DELETE FROM controller WHERE position < (SELECT max(position) FROM controller) AND position IN"
        " (SELECT position FROM (SELECT position, sum(length(json) + length(said)) OVER (ORDER BY position DESC)"
        " AS total FROM controller) WHERE total > ?)",
        (most_bytes,),
    )
    return True


def read(sql: sqlite3.Connection, vehicle: str) -> list[str]:
    """Return the reports of a vehicle as JSON, the oldest first."""
    rows = sql.execute("SELECT json FROM controller WHERE vehicle = ? ORDER BY position", (vehicle,)).fetchall()
    return [str(text) for (text,) in rows]
