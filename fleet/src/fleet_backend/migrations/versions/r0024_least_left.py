"""The watch keeps how far a fluid lasts at least, which is known before there is a trend."""

from collections.abc import Sequence

from alembic import op
from sqlalchemy import Column, Double, inspect

revision: str = "r0024"
down_revision: str | None = "r0023"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Add the distance, and let the watch judge all vehicles anew; a database that is made from nothing has it."""
    if "least_left_m" not in {column["name"] for column in inspect(op.get_bind()).get_columns("fluid_due")}:
        op.add_column("fluid_due", Column("least_left_m", Double))
        op.execute("UPDATE fluid_due SET mark = NULL")
