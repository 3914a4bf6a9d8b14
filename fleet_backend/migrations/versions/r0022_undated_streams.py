"""Streams without dates follow others by their arrival; trends tell since when their fluid was in."""

from collections.abc import Sequence

from alembic import op

from fleet_backend.months import FUNCTIONS, RANK
from fleet_backend.schema import RANK_INDEX
from fleet_backend.views import make_views

revision: str = "r0022"
down_revision: str | None = "r0021"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Make the views, and all that holds ranks, anew; PostgreSQL reads all results once."""
    connection = op.get_bind()
    if connection.dialect.name == "postgresql":
        for statement in (*FUNCTIONS, RANK):
            connection.exec_driver_sql(statement)
    else:
        RANK_INDEX.drop(connection)
        RANK_INDEX.create(connection)
    for name in ("vehicle_lot", "clutch_month"):  # which nobody reads any more
        op.execute(f"DROP TABLE IF EXISTS {name}")
    make_views(connection)
