"""The tables that no result needs: alarms and their messages, who changed what, quotas, what the office works out."""

import uuid
from datetime import datetime
from typing import Final

from sqlalchemy import (
    BigInteger,
    Column,
    Connection,
    Date,
    Double,
    ForeignKey,
    Index,
    SmallInteger,
    Table,
    Text,
    insert,
    text,
)

from fleet_backend.schema import METADATA, UtcDateTime

__all__ = ["METADATA"]  # with the tables of both modules

_OPEN: Final = text("cleared_at IS NULL")
_WAITING: Final = text("delivered_at IS NULL")

ALARM: Final = Table(
    "alarm",
    METADATA,
    Column("vehicle", Text, ForeignKey("vehicle.vehicle"), primary_key=True),
    Column("clutch", SmallInteger, primary_key=True, autoincrement=False),  # 0: of the vehicle as a whole
    Column("rule", Text, primary_key=True),
    Column("number", BigInteger, primary_key=True, autoincrement=False),  # from 1 on, of each subject
    Column("raised_at", UtcDateTime, nullable=False),
    Column("cleared_at", UtcDateTime),
    Column("reason", Text, nullable=False),
    Column("acknowledged_at", UtcDateTime),
    Column("acknowledged_by", Text),
    Column("note", Text),
    Index("alarm_open", "vehicle", "clutch", "rule", unique=True, postgresql_where=_OPEN, sqlite_where=_OPEN),
    Index("alarm_by_time", "raised_at"),
)

ALARM_MESSAGE: Final = Table(
    "alarm_message",
    METADATA,
    Column("key", Text, primary_key=True),  # of the alarm and what happened to it
    Column("carrier", Text, primary_key=True),
    Column("payload", Text, nullable=False),  # JSON object
    Column("made_at", UtcDateTime, nullable=False),
    Column("attempt_count", BigInteger, nullable=False),
    Column("next_try_at", UtcDateTime, nullable=False),
    Column("claimed_until", UtcDateTime),  # one process at a time delivers it
    Column("delivered_at", UtcDateTime),
    Column("complaint", Text),  # why the last attempt failed
    Index("alarm_message_waiting", "carrier", "next_try_at", postgresql_where=_WAITING, sqlite_where=_WAITING),
)

INTAKE: Final = Table(  # what came of each vehicle on the last day (UTC) on which it spoke; quotas are held by it
    "intake",
    METADATA,
    Column("vehicle", Text, primary_key=True),
    Column("day", Date, nullable=False),
    Column("result_count", BigInteger, nullable=False),
    Column("quarantined_count", BigInteger, nullable=False),
    Column("byte_count", BigInteger, nullable=False),
    Column("withheld_count", BigInteger, nullable=False),  # messages beyond a quota
)

FLUID_DUE: Final = Table(  # what the watch foretold last; of another action or fluid it holds no more
    "fluid_due",
    METADATA,
    Column("vehicle", Text, primary_key=True),
    Column("clutch", SmallInteger, primary_key=True, autoincrement=False),
    Column("judged_at", UtcDateTime, nullable=False),
    Column("action", Text, nullable=False),
    Column("fluid_since", UtcDateTime),
    Column("due_from", Date),
    Column("half_by", Date),
    Column("most_by", Date),
    Column("distance_a_day_m", Double),
    Column("outlook", Text, nullable=False),
    Column("mark", Text),  # of all that it was judged by; null: of programs that did not tell
    Column("least_left_m", Double),  # that the fluid lasts at least, 90 % sure, from the last event on
)

POPULATION: Final = Table(
    "population",
    METADATA,
    Column("version", BigInteger, primary_key=True, autoincrement=False),
    Column("learned_at", UtcDateTime, nullable=False),
    Column("clutch_count", BigInteger, nullable=False),  # learned from
    Column("content", Text, nullable=False),  # JSON object
)

AUDIT: Final = Table(
    "audit",
    METADATA,
    Column("audit_id", Text, primary_key=True),
    Column("at", UtcDateTime, nullable=False),
    Column("who", Text, nullable=False),
    Column("role", Text, nullable=False),
    Column("action", Text, nullable=False),
    Column("subject", Text, nullable=False),
    Index("audit_by_time", "at"),
)


COMMAND_LINE: Final = "command line"  # the role of who has a shell where the database is open to him


def note_change(
    connection: Connection, action: str, subject: str, *, at: datetime, by: str, role: str = COMMAND_LINE
) -> None:
    """Note in the audit who changed what, and when."""
    values = {"audit_id": str(uuid.uuid4()), "at": at, "who": by, "role": role, "action": action, "subject": subject}
    connection.execute(insert(AUDIT).values(**values))
