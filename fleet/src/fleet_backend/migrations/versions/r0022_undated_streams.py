"""Streams without dates follow others by arrival; trends tell since when their fluid was in; alarms stand once."""

from collections.abc import Sequence

from alembic import op
from sqlalchemy import inspect

from fleet_backend.months import FUNCTIONS, RANK
from fleet_backend.schema import RANK_INDEX

revision: str = "r0022"
down_revision: str | None = "r0021"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None
_TAKE_OVER = """
UPDATE alarm SET acknowledged_at = v.acknowledged_at, acknowledged_by = v.acknowledged_by, note = v.note
FROM clutch_alarm AS v
WHERE v.vehicle = alarm.vehicle AND v.clutch = alarm.clutch AND alarm.rule = 'verdict' AND v.acknowledged_at IS NOT NULL
  AND v.cleared_at IS NULL AND alarm.cleared_at IS NULL AND alarm.acknowledged_at IS NULL
"""


def upgrade() -> None:
    """Make all that holds ranks anew; PostgreSQL reads all results once. A later migration makes the views."""
    connection = op.get_bind()
    if inspect(connection).has_table("alarm_acknowledgement"):  # not in a database that is made from nothing
        op.execute(_TAKE_OVER)
        op.execute("DROP VIEW clutch_alarm")
    if connection.dialect.name == "postgresql":
        for statement in (*FUNCTIONS, RANK):
            connection.exec_driver_sql(statement)
    else:
        RANK_INDEX.drop(connection)
        RANK_INDEX.create(connection)
    for name in ("vehicle_lot", "clutch_month", "clutch_block", "alarm_acknowledgement"):  # which nobody reads any more
        op.execute(f"DROP TABLE IF EXISTS {name}")
