"""Results by months: partitions in PostgreSQL, and in both databases what is left of a month when its results go."""

from collections.abc import Sequence
from typing import Final

import sqlalchemy as sa
from alembic import op

from fleet_backend.migrations.versions.r0002_views import VIEWS
from fleet_backend.months.moving import move_some, prepare, swap

revision: str = "r0008"
down_revision: str | None = "r0007"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None

_TREND_END: Final = "h.condition, h.level_ratio, h.stream, h.seq, h.algorithm_version, h.calibration_version,"
_CONDITION_HEAD: Final = "s.vehicle, s.clutch, s.condition, s.condition_reason, s.level_ratio,"
_NEWER: Final = "AND newer.version_rank > s.version_rank"
# Of two contents under one key, which nobody should send, in two months: the one that wins inside a month.
_NEWER_OR_BETTER: Final = (
    "AND newer.version_rank >= s.version_rank"
    " AND (newer.version_rank > s.version_rank OR newer.content_digest < s.content_digest)"
)


def upgrade() -> None:
    """Create what is new; results of PostgreSQL that have not moved by now move here."""
    op.create_table(
        "clutch_month",
        sa.Column("vehicle", sa.Text, primary_key=True),
        sa.Column("clutch", sa.SmallInteger, primary_key=True, autoincrement=False),
        sa.Column("month", sa.Date, primary_key=True),
        sa.Column("result_count", sa.BigInteger, nullable=False),
        sa.Column("valid_count", sa.BigInteger, nullable=False),
        sa.Column("change_fluid_count", sa.BigInteger, nullable=False),
        sa.Column("mean_mu_c", sa.Double),
        sa.Column("mean_mu_s", sa.Double),
        sa.Column("least_level_ratio", sa.Double),
        sa.Column("last_odometer_m", sa.Double),
    )
    connection = op.get_bind()
    if connection.dialect.name != "postgresql":
        return
    prepare(connection)
    move_some(connection, None)
    # Shorter than the second after which PostgreSQL ends one of two that wait for each other: readers must not be it.
    connection.exec_driver_sql("SET LOCAL lock_timeout = '400ms'")
    connection.exec_driver_sql("LOCK TABLE shift_result IN ACCESS EXCLUSIVE MODE")
    for view in reversed(VIEWS):
        op.execute(f"DROP VIEW {view.split()[2]}")
    swap(connection)
    for view in VIEWS:
        as_since_r0005 = view.replace(_TREND_END, f"{_TREND_END} h.kind, h.end_reason,")
        as_since_r0005 = as_since_r0005.replace(_CONDITION_HEAD, f"{_CONDITION_HEAD} s.advice,")
        op.execute(as_since_r0005.replace(_NEWER, _NEWER_OR_BETTER))
