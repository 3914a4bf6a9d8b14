"""What is current is told by arrival where a vehicle's clock is ahead: a result dated 2038 hides no newer ones."""

from collections.abc import Sequence
from typing import Final

from alembic import op

from fleet_backend.months import FUNCTIONS

revision: str = "r0014"
down_revision: str | None = "r0013"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None

_RANKS: Final = {
    "max(c.produced_at)": "max(min(c.produced_at, c.stored_at))",
    "max(s.produced_at)": "max(min(s.produced_at, s.stored_at))",
    "l.produced_at DESC": "min(l.produced_at, l.stored_at) DESC",
}


def upgrade() -> None:
    """Rank by the earlier of both times; PostgreSQL keeps it with each stream, SQLite in an index."""
    connection = op.get_bind()
    if connection.dialect.name == "postgresql":
        for function in FUNCTIONS:
            connection.exec_driver_sql(function)
        connection.exec_driver_sql("UPDATE clutch_stream SET last_at = least(last_at, last_stored_at)")
        history = connection.exec_driver_sql("SELECT pg_get_viewdef('shift_history'::regclass)").scalar_one()
        changed = str(history).replace("max(c.produced_at)", "max(least(c.produced_at, c.stored_at))")
        connection.exec_driver_sql(f"CREATE OR REPLACE VIEW shift_history AS {changed}")
        return
    connection.exec_driver_sql(
        "CREATE INDEX shift_by_rank ON shift_result (vehicle, clutch, min(produced_at, stored_at), stream)"
    )
    views = connection.exec_driver_sql("SELECT name, sql FROM sqlite_master WHERE type = 'view'").all()
    for name, statement in views:
        changed = statement
        for before, after in _RANKS.items():
            changed = changed.replace(before, after)
        if changed != statement:
            connection.exec_driver_sql(f"DROP VIEW {name}")
            connection.exec_driver_sql(changed)
