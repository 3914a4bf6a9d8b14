"""How much came of each vehicle today, for quotas."""

from collections.abc import Sequence

from alembic import op

from fleet_backend.office_tables import INTAKE

revision: str = "r0016"
down_revision: str | None = "r0015"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Create what is new."""
    INTAKE.create(op.get_bind())
