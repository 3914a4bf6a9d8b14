"""In PostgreSQL: where results are, filled from all that are there; who writes waits meanwhile, who reads does not."""

from collections.abc import Sequence

from alembic import op

from fleet_backend.months.locations import FILL, FOLLOW, MAKE

revision: str = "r0009"
down_revision: str | None = "r0008"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Create what is new."""
    connection = op.get_bind()
    if connection.dialect.name != "postgresql":
        return
    connection.exec_driver_sql("LOCK TABLE shift_result IN SHARE ROW EXCLUSIVE MODE")
    for statement in (*MAKE, *FILL, *FOLLOW):
        connection.exec_driver_sql(statement)
    for name in ("clutch_stream", "clutch_block"):
        connection.exec_driver_sql(f"ANALYZE {name}")
