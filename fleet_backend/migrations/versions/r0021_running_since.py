"""How far back a running estimate goes: whether it rests on an earlier fluid."""

from collections.abc import Sequence

from alembic import op

revision: str = "r0021"
down_revision: str | None = "r0020"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Add what is new; earlier results do not tell it."""
    op.get_bind().exec_driver_sql("ALTER TABLE shift_result ADD COLUMN running_since_bus_ns BIGINT")
