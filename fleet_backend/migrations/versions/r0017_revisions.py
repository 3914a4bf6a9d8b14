"""What later results made of earlier ones."""

from collections.abc import Sequence

from alembic import op

from fleet_backend.schema import REVISION

revision: str = "r0017"
down_revision: str | None = "r0016"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Create what is new."""
    REVISION.create(op.get_bind())
