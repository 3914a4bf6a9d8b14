"""Fluid fills that were noted by mistake: their moments, so that nobody brings them back."""

from collections.abc import Sequence

import sqlalchemy as sa
from alembic import op

revision: str = "r0012"
down_revision: str | None = "r0011"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Create what is new."""
    op.create_table(
        "withdrawn_fill",
        sa.Column("vehicle", sa.Text, primary_key=True),
        sa.Column("filled_at", sa.DateTime(timezone=True), primary_key=True),
    )
