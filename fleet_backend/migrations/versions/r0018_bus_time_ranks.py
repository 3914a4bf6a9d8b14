"""What is current is told by when it happened, where the bus's time has a date: an old log hides no newer results."""

import re
from collections.abc import Sequence

from alembic import op

from fleet_backend.months import FUNCTIONS
from fleet_backend.schema import HAPPENED_AT

revision: str = "r0018"
down_revision: str | None = "r0017"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Rank by the earliest of three times; PostgreSQL reads all results once."""
    connection = op.get_bind()
    rank = f"(c.produced_at, c.stored_at, {HAPPENED_AT.format('c.')})"
    if connection.dialect.name == "postgresql":
        for function in FUNCTIONS:
            connection.exec_driver_sql(function)
        connection.exec_driver_sql(
            f"UPDATE clutch_stream AS e SET last_at = s.at FROM (SELECT vehicle, clutch, stream, max(least{rank}) AS at"  # noqa: S608
            " FROM shift_result AS c GROUP BY vehicle, clutch, stream) AS s"
            " WHERE s.vehicle = e.vehicle AND s.clutch = e.clutch AND s.stream = e.stream AND s.at < e.last_at"
        )
        history = connection.exec_driver_sql("SELECT pg_get_viewdef('shift_history'::regclass)").scalar_one()
        changed = str(history).replace("LEAST(c.produced_at, c.stored_at)", f"LEAST{rank}")
        connection.exec_driver_sql(f"CREATE OR REPLACE VIEW shift_history AS {changed}")
        return
    connection.exec_driver_sql("DROP INDEX shift_by_rank")
    own = rank.replace("c.", "")
    connection.exec_driver_sql(f"CREATE INDEX shift_by_rank ON shift_result (vehicle, clutch, min{own}, stream)")
    views = connection.exec_driver_sql("SELECT name, sql FROM sqlite_master WHERE type = 'view'").all()
    for name, statement in views:
        changed = re.sub(
            r"min\((\w\.)produced_at, \1stored_at\)", lambda found: f"min{rank.replace('c.', found[1])}", statement
        )
        if changed != statement:
            connection.exec_driver_sql(f"DROP VIEW {name}")
            connection.exec_driver_sql(changed)
