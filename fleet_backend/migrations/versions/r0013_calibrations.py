"""What vehicles say of their calibrations: type, and friction of new fluid."""

from collections.abc import Sequence

import sqlalchemy as sa
from alembic import op

revision: str = "r0013"
down_revision: str | None = "r0012"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Create what is new."""
    op.create_table(
        "calibration",
        sa.Column("vehicle", sa.Text, primary_key=True),
        sa.Column("calibration_version", sa.Text, primary_key=True),
        sa.Column("content", sa.Text, nullable=False),
    )
