"""The days on which fluids are due, as the watch foretold them last: a whole fleet is shown in their order."""

from collections.abc import Sequence

from alembic import op

from fleet_backend.office_tables import FLUID_DUE

revision: str = "r0015"
down_revision: str | None = "r0014"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Create what is new."""
    FLUID_DUE.create(op.get_bind())
