"""Vehicles, clutches, shift results and quarantine."""

from collections.abc import Sequence

import sqlalchemy as sa
from alembic import op

revision: str = "r0001"
down_revision: str | None = None
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None

_FRICTION = (
    "mu_c",
    "mu_s",
    "std_mu_c",
    "std_mu_s",
    "correlation",
    "random_std_mu_c",
    "random_std_mu_s",
    "slope_s_rad",
    "std_slope_s_rad",
    "probability_negative_slope",
)


def upgrade() -> None:
    """Create the tables."""
    moment = sa.DateTime(timezone=True)
    op.create_table(
        "vehicle",
        sa.Column("vehicle", sa.Text, primary_key=True),
        sa.Column("is_online", sa.Boolean),
        sa.Column("connected_at", moment),
        sa.Column("service_version", sa.Text),
        sa.Column("algorithm_version", sa.Text),
        sa.Column("calibration_version", sa.Text),
    )
    op.create_table(
        "clutch",
        sa.Column("vehicle", sa.Text, sa.ForeignKey("vehicle.vehicle"), primary_key=True),
        sa.Column("clutch", sa.SmallInteger, primary_key=True, autoincrement=False),
    )
    op.create_table("shift_result", *_shift_columns())
    op.create_index("shift_by_time", "shift_result", ["vehicle", "clutch", "produced_at", "stream"])
    op.create_table(
        "quarantine",
        sa.Column("digest", sa.Text, primary_key=True),
        sa.Column("topic", sa.Text, nullable=False),
        sa.Column("vehicle", sa.Text),
        sa.Column("reason", sa.Text, nullable=False),
        sa.Column("detail", sa.Text, nullable=False),
        sa.Column("size_bytes", sa.BigInteger, nullable=False),
        sa.Column("head", sa.Text, nullable=False),
        sa.Column("received_at", moment, nullable=False),
    )
    op.create_index("quarantine_by_time", "quarantine", ["received_at"])


def _shift_columns() -> list[sa.schema.SchemaItem]:
    moment = sa.DateTime(timezone=True)
    key = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")
    return [
        sa.Column("vehicle", sa.Text, primary_key=True),
        sa.Column("stream", key, primary_key=True),
        sa.Column("seq", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("version_rank", key, primary_key=True),
        sa.Column("algorithm_version", sa.Text, nullable=False),
        sa.Column("calibration_version", sa.Text, nullable=False),
        sa.Column("clutch", sa.SmallInteger, nullable=False),
        sa.Column("number", sa.BigInteger, nullable=False),
        sa.Column("produced_at", moment, nullable=False),
        sa.Column("start_at", moment, nullable=False),
        sa.Column("end_at", moment, nullable=False),
        sa.Column("start_bus_ns", sa.BigInteger, nullable=False),
        sa.Column("end_bus_ns", sa.BigInteger, nullable=False),
        sa.Column("duration_s", sa.Double, nullable=False),
        sa.Column("from_gear", sa.BigInteger, nullable=False),
        sa.Column("to_gear", sa.BigInteger, nullable=False),
        sa.Column("status", sa.Text, nullable=False),
        sa.Column("reasons", sa.Text, nullable=False),
        *(sa.Column(name, sa.Double) for name in _FRICTION),
        sa.Column("sample_count", sa.BigInteger, nullable=False),
        sa.Column("window_s", sa.Double, nullable=False),
        sa.Column("chi_square_ratio", sa.Double, nullable=False),
        sa.Column("quality", sa.Double, nullable=False),
        sa.Column("sump_temperature_k", sa.Double),
        sa.Column("clutch_temperature_k", sa.Double),
        sa.Column("slip_energy_j", sa.Double),
        sa.Column("odometer_m", sa.Double),
        sa.Column("condition", sa.Text, nullable=False),
        sa.Column("condition_reason", sa.Text, nullable=False),
        sa.Column("level_ratio", sa.Double),
        *(sa.Column(f"running_{name}", sa.Double) for name in _FRICTION),
        sa.Column("running_shift_count", sa.BigInteger, nullable=False),
        sa.Column("content_digest", sa.BigInteger, nullable=False),
        sa.Column("stored_at", moment, nullable=False, server_default=sa.text("CURRENT_TIMESTAMP")),
        sa.ForeignKeyConstraint(["vehicle", "clutch"], ["clutch.vehicle", "clutch.clutch"]),
    ]
