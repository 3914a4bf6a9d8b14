"""The tables of a fleet, as the program knows them; in PostgreSQL results by months, with what tells where they are."""

from collections.abc import Sequence
from datetime import UTC, datetime

from alembic import op

from fleet_backend.months import AHEAD_MONTHS, FOLLOW, MAKE, make_partitions, month_of, months_on
from fleet_backend.office_tables import METADATA

revision: str = "r0021"
down_revision: str | None = None
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Create all."""
    connection = op.get_bind()
    METADATA.create_all(connection)
    if connection.dialect.name == "postgresql":
        for statement in (*MAKE, *FOLLOW):
            connection.exec_driver_sql(statement)
        this = month_of(datetime.now(UTC))
        make_partitions(connection, "shift_result", this, months_on(this, AHEAD_MONTHS + 1))
