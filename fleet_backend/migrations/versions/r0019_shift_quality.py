"""How well gear changes went, and the names of clutches that are no pair."""

from collections.abc import Sequence

from alembic import op

revision: str = "r0019"
down_revision: str | None = "r0018"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Add what is new; earlier results do not tell it."""
    for table, name in (("shift_result", "shift_quality"), ("shift_result", "element"), ("clutch", "element")):
        op.get_bind().exec_driver_sql(f"ALTER TABLE {table} ADD COLUMN {name} TEXT")
