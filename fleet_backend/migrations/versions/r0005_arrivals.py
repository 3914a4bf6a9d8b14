"""When results arrived, for whoever asks what is new; what a prognosis and a page need of each result besides."""

from collections.abc import Sequence
from typing import Final

import sqlalchemy as sa
from alembic import op

from fleet_backend.migrations.versions.r0002_views import VIEWS

revision: str = "r0005"
down_revision: str | None = "r0004"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None

_SCALE_FREE: Final = ("mu_c", "mu_s", "std_mu_c", "std_mu_s", "correlation")
_TREND_END: Final = "h.condition, h.level_ratio, h.stream, h.seq, h.algorithm_version, h.calibration_version,"
_CONDITION_HEAD: Final = "s.vehicle, s.clutch, s.condition, s.condition_reason, s.level_ratio,"


def upgrade() -> None:
    """Create what is new; a view has the columns that its table had when it was made, so all are made again."""
    for view in reversed(VIEWS):
        op.execute(f"DROP VIEW {view.split()[2]}")
    for name in _SCALE_FREE:
        op.add_column("shift_result", sa.Column(f"scale_free_{name}", sa.Double))
    op.add_column("shift_result", sa.Column("trust", sa.Double))
    op.add_column("shift_result", sa.Column("trust_parts", sa.Text))
    op.create_index("shift_by_arrival", "shift_result", ["stored_at"])
    for view in VIEWS:
        as_since_r0003 = view.replace(_TREND_END, f"{_TREND_END} h.kind, h.end_reason,")
        op.execute(as_since_r0003.replace(_CONDITION_HEAD, f"{_CONDITION_HEAD} s.advice,"))
