"""The tables of alarms by rules, of the messages that tell of them, and of who changed what."""

from typing import Final

from sqlalchemy import BigInteger, Column, ForeignKey, Index, SmallInteger, Table, Text, text

from fleet_backend.schema import METADATA, UtcDateTime

__all__ = ["ALARM", "ALARM_MESSAGE", "AUDIT", "METADATA"]

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
