"""Alarms by rules, the messages that tell of them, and who changed what."""

from collections.abc import Sequence

import sqlalchemy as sa
from alembic import op

revision: str = "r0006"
down_revision: str | None = "r0005"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Create what is new."""
    moment = sa.DateTime(timezone=True)
    op.create_table(
        "alarm",
        sa.Column("vehicle", sa.Text, sa.ForeignKey("vehicle.vehicle"), primary_key=True),
        sa.Column("clutch", sa.SmallInteger, primary_key=True, autoincrement=False),
        sa.Column("rule", sa.Text, primary_key=True),
        sa.Column("number", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("raised_at", moment, nullable=False),
        sa.Column("cleared_at", moment),
        sa.Column("reason", sa.Text, nullable=False),
        sa.Column("acknowledged_at", moment),
        sa.Column("acknowledged_by", sa.Text),
        sa.Column("note", sa.Text),
    )
    is_open = sa.text("cleared_at IS NULL")
    op.create_index(
        "alarm_open",
        "alarm",
        ["vehicle", "clutch", "rule"],
        unique=True,
        postgresql_where=is_open,
        sqlite_where=is_open,
    )
    op.create_index("alarm_by_time", "alarm", ["raised_at"])
    op.create_table(
        "alarm_message",
        sa.Column("key", sa.Text, primary_key=True),
        sa.Column("carrier", sa.Text, primary_key=True),
        sa.Column("payload", sa.Text, nullable=False),
        sa.Column("made_at", moment, nullable=False),
        sa.Column("attempt_count", sa.BigInteger, nullable=False),
        sa.Column("next_try_at", moment, nullable=False),
        sa.Column("claimed_until", moment),
        sa.Column("delivered_at", moment),
        sa.Column("complaint", sa.Text),
    )
    is_waiting = sa.text("delivered_at IS NULL")
    op.create_index(
        "alarm_message_waiting",
        "alarm_message",
        ["carrier", "next_try_at"],
        postgresql_where=is_waiting,
        sqlite_where=is_waiting,
    )
    op.create_table(
        "audit",
        sa.Column("audit_id", sa.Text, primary_key=True),
        sa.Column("at", moment, nullable=False),
        sa.Column("who", sa.Text, nullable=False),
        sa.Column("role", sa.Text, nullable=False),
        sa.Column("action", sa.Text, nullable=False),
        sa.Column("subject", sa.Text, nullable=False),
    )
    op.create_index("audit_by_time", "audit", ["at"])
