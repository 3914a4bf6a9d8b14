"""Why a vehicle is as it is."""

from collections.abc import Sequence

from alembic import op

revision: str = "r0020"
down_revision: str | None = "r0019"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Add what is new; earlier results do not tell it."""
    op.get_bind().exec_driver_sql("ALTER TABLE shift_result ADD COLUMN causes TEXT")
