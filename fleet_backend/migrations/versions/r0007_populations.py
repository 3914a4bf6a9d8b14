"""What vehicles have in common: lots by which they are known, and populations that were learned."""

from collections.abc import Sequence

import sqlalchemy as sa
from alembic import op

revision: str = "r0007"
down_revision: str | None = "r0006"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Create what is new."""
    op.create_table(
        "vehicle_lot",
        sa.Column("vehicle", sa.Text, primary_key=True),
        sa.Column("name", sa.Text, primary_key=True),
        sa.Column("value", sa.Text, nullable=False),
    )
    op.create_table(
        "population",
        sa.Column("version", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("learned_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("clutch_count", sa.BigInteger, nullable=False),
        sa.Column("content", sa.Text, nullable=False),
    )
