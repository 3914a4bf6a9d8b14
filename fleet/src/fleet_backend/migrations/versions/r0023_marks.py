"""What the watch judged is marked by what it was judged by, so that no process judges it twice."""

from collections.abc import Sequence

from alembic import op
from sqlalchemy import Column, Text, inspect

revision: str = "r0023"
down_revision: str | None = "r0022"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Add the mark; a database that is made from nothing has it."""
    if "mark" not in {column["name"] for column in inspect(op.get_bind()).get_columns("fluid_due")}:
        op.add_column("fluid_due", Column("mark", Text))
