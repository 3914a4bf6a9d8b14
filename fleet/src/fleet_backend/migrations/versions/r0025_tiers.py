"""Of a vehicle that tells no friction it is kept what it tells instead, and what its signals suffice for."""

from collections.abc import Sequence

from alembic import op
from sqlalchemy import Column, SmallInteger, Text, inspect

from fleet_backend.views import make_views

revision: str = "r0025"
down_revision: str | None = "r0024"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None


def upgrade() -> None:
    """Add both columns, empty; a database that is made from nothing has them, and its views, already."""
    known = {column["name"] for column in inspect(op.get_bind()).get_columns("shift_result")}
    for column in (Column("tier", SmallInteger), Column("indices", Text)):
        if column.name not in known:
            op.add_column("shift_result", column)
    make_views(op.get_bind())
