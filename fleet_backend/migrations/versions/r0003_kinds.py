"""What kind of event a result is of and how it ended, and the advice of its verdict; the views that show them."""

from collections.abc import Sequence
from typing import Final

import sqlalchemy as sa
from alembic import op

from fleet_backend.migrations.versions.r0002_views import VIEWS

revision: str = "r0003"
down_revision: str | None = "r0002"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None

_TREND_END: Final = "h.condition, h.level_ratio, h.stream, h.seq, h.algorithm_version, h.calibration_version,"
_CONDITION_HEAD: Final = "s.vehicle, s.clutch, s.condition, s.condition_reason, s.level_ratio,"
_COLUMNS: Final = ("kind", "end_reason", "advice")


def upgrade() -> None:
    """Create what is new; a view has the columns that its table had when it was made, so all are made again."""
    for view in reversed(VIEWS):
        op.execute(f"DROP VIEW {view.split()[2]}")
    for column in _COLUMNS:
        op.add_column("shift_result", sa.Column(column, sa.Text))
    for view in VIEWS:
        changed = view.replace(_TREND_END, f"{_TREND_END} h.kind, h.end_reason,")
        op.execute(changed.replace(_CONDITION_HEAD, f"{_CONDITION_HEAD} s.advice,"))
