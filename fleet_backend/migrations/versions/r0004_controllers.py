"""What a controller of a vehicle last said of its trouble codes."""

from collections.abc import Sequence

import sqlalchemy as sa
from alembic import op

revision: str = "r0004"
down_revision: str | None = "r0003"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Create what is new; no view shows it."""
    op.add_column("vehicle", sa.Column("controller", sa.Text))
    op.add_column("vehicle", sa.Column("controller_at", sa.DateTime(timezone=True)))
