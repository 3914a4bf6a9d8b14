"""Fluid fills, acknowledgements and metrics; the views that users query."""

from collections.abc import Sequence

import sqlalchemy as sa
from alembic import op

revision: str = "r0002"
down_revision: str | None = "r0001"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None

_CURRENT_SHIFT = """
CREATE VIEW current_shift AS
SELECT s.*
FROM shift_result AS s
WHERE NOT EXISTS (
  SELECT 1 FROM shift_result AS newer
  WHERE newer.vehicle = s.vehicle AND newer.stream = s.stream AND newer.seq = s.seq
    AND newer.version_rank > s.version_rank
)
"""

# Clocks jump, so inside a stream only seq tells the order; streams follow each other by their last result.
_SHIFT_HISTORY = """
CREATE VIEW shift_history AS
SELECT h.*, row_number() OVER (
  PARTITION BY h.vehicle, h.clutch ORDER BY h.stream_last_at, h.stream, h.seq
) AS shift_number
FROM (
  SELECT c.*, max(c.produced_at) OVER (PARTITION BY c.vehicle, c.stream) AS stream_last_at
  FROM current_shift AS c
) AS h
"""

_CLUTCH_TREND = """
CREATE VIEW clutch_trend AS
SELECT
  h.vehicle, h.clutch, h.shift_number, h.odometer_m, h.end_at,
  h.mu_c, h.mu_s, h.std_mu_c, h.std_mu_s, h.random_std_mu_c, h.random_std_mu_s,
  h.correlation * h.std_mu_c * h.std_mu_s AS covariance_mu_c_mu_s,
  h.slope_s_rad, h.std_slope_s_rad, h.probability_negative_slope, h.quality, h.clutch_temperature_k,
  h.running_mu_c, h.running_std_mu_c, h.running_random_std_mu_c,
  h.running_mu_s, h.running_std_mu_s, h.running_random_std_mu_s,
  h.running_slope_s_rad, h.running_std_slope_s_rad, h.running_probability_negative_slope,
  h.condition, h.level_ratio, h.stream, h.seq, h.algorithm_version, h.calibration_version,
  (
    SELECT f.product FROM fluid_fill AS f
    WHERE f.vehicle = h.vehicle AND f.filled_at <= h.end_at
    ORDER BY f.filled_at DESC LIMIT 1
  ) AS fluid
FROM shift_history AS h
WHERE h.status = 'valid'
"""

# One index look-up per clutch; CROSS JOIN keeps SQLite from reading all shifts first.
_RUNNING_CONDITION = """
CREATE VIEW running_condition AS
SELECT
  s.vehicle, s.clutch, s.condition, s.condition_reason, s.level_ratio, s.running_shift_count AS shift_count,
  s.running_mu_c AS mu_c, s.running_mu_s AS mu_s, s.running_std_mu_c AS std_mu_c, s.running_std_mu_s AS std_mu_s,
  s.running_correlation AS correlation,
  s.running_correlation * s.running_std_mu_c * s.running_std_mu_s AS covariance_mu_c_mu_s,
  s.running_slope_s_rad AS slope_s_rad, s.running_std_slope_s_rad AS std_slope_s_rad,
  s.running_probability_negative_slope AS probability_negative_slope,
  s.odometer_m, s.end_at, s.produced_at, s.stream, s.seq, s.algorithm_version, s.calibration_version
FROM (
  SELECT q.vehicle, q.clutch, q.stream, (
    SELECT n.seq FROM shift_result AS n
    WHERE n.vehicle = q.vehicle AND n.stream = q.stream AND n.clutch = q.clutch
    ORDER BY n.vehicle DESC, n.stream DESC, n.seq DESC LIMIT 1
  ) AS seq
  FROM (
    SELECT k.vehicle, k.clutch, (
      SELECT l.stream FROM shift_result AS l
      WHERE l.vehicle = k.vehicle AND l.clutch = k.clutch
      ORDER BY l.vehicle DESC, l.clutch DESC, l.produced_at DESC, l.stream DESC LIMIT 1
    ) AS stream
    FROM clutch AS k
  ) AS q
) AS p
CROSS JOIN current_shift AS s
WHERE s.vehicle = p.vehicle AND s.stream = p.stream AND s.seq = p.seq
"""

_FLEET = """
CREATE VIEW fleet_worst_first AS
SELECT row_number() OVER (
  ORDER BY w.severity DESC, coalesce(w.probability_negative_slope, 0.0) DESC, coalesce(w.level_ratio, 9.0),
  w.vehicle, w.clutch
) AS place, w.*
FROM (
  SELECT
    CASE r.condition WHEN 'change_fluid' THEN 3 WHEN 'watch' THEN 2 WHEN 'good' THEN 1 ELSE 0 END AS severity,
    r.*,
    r.mu_c - 2 * r.std_mu_c AS mu_c_low, r.mu_c + 2 * r.std_mu_c AS mu_c_high,
    r.mu_s - 2 * r.std_mu_s AS mu_s_low, r.mu_s + 2 * r.std_mu_s AS mu_s_high,
    r.slope_s_rad - 2 * r.std_slope_s_rad AS slope_low_s_rad,
    r.slope_s_rad + 2 * r.std_slope_s_rad AS slope_high_s_rad,
    (
      SELECT f.product FROM fluid_fill AS f
      WHERE f.vehicle = r.vehicle AND f.filled_at <= r.end_at
      ORDER BY f.filled_at DESC LIMIT 1
    ) AS fluid
  FROM running_condition AS r
) AS w
"""

_LAST_SEEN = """
CREATE VIEW last_seen AS
SELECT v.vehicle, v.is_online, v.connected_at, v.service_version, v.metrics_at, (
  SELECT max((
    SELECT max(s.produced_at) FROM shift_result AS s WHERE s.vehicle = k.vehicle AND s.clutch = k.clutch
  )) FROM clutch AS k WHERE k.vehicle = v.vehicle
) AS last_result_at
FROM vehicle AS v
"""

# Runs of verdicts that say change_fluid; a shift without verdict neither raises nor clears. It reads the history of
# those vehicles alone that ever had such a verdict, which the partial index finds.
_CLUTCH_ALARM = """
CREATE VIEW clutch_alarm AS
WITH streams AS (
  SELECT c.vehicle, c.clutch, c.stream, c.seq, c.end_at, c.condition, c.condition_reason,
    max(c.produced_at) OVER (PARTITION BY c.vehicle, c.stream) AS stream_last_at
  FROM current_shift AS c
  WHERE c.vehicle IN (SELECT a.vehicle FROM shift_result AS a WHERE a.condition = 'change_fluid')
), history AS (
  SELECT h.*, row_number() OVER (
    PARTITION BY h.vehicle, h.clutch ORDER BY h.stream_last_at, h.stream, h.seq
  ) AS shift_number
  FROM streams AS h
), verdicts AS (
  SELECT g.vehicle, g.clutch, g.stream, g.seq, g.end_at, g.shift_number, g.condition_reason,
    CASE g.condition WHEN 'change_fluid' THEN 1 ELSE 0 END AS alarming
  FROM history AS g
  WHERE g.condition <> 'no_verdict'
), neighbours AS (
  SELECT v.*,
    coalesce(lag(v.alarming) OVER (PARTITION BY v.vehicle, v.clutch ORDER BY v.shift_number), 0) AS was_alarming,
    lead(v.alarming) OVER (PARTITION BY v.vehicle, v.clutch ORDER BY v.shift_number) AS will_alarm,
    lead(v.end_at) OVER (PARTITION BY v.vehicle, v.clutch ORDER BY v.shift_number) AS next_end_at
  FROM verdicts AS v
), numbered AS (
  SELECT n.*, sum(CASE WHEN n.alarming = 1 AND n.was_alarming = 0 THEN 1 ELSE 0 END) OVER (
    PARTITION BY n.vehicle, n.clutch ORDER BY n.shift_number
  ) AS alarm_number
  FROM neighbours AS n
)
SELECT
  m.vehicle, m.clutch, m.alarm_number,
  max(CASE WHEN m.was_alarming = 0 THEN m.end_at END) AS raised_at,
  max(CASE WHEN m.will_alarm = 0 THEN m.next_end_at END) AS cleared_at,
  count(DISTINCT m.shift_number) AS shift_count,
  max(CASE WHEN m.was_alarming = 0 THEN m.condition_reason END) AS reason,
  max(CASE WHEN m.was_alarming = 0 THEN m.stream END) AS stream,
  max(CASE WHEN m.was_alarming = 0 THEN m.seq END) AS seq,
  max(a.acknowledged_at) AS acknowledged_at,
  max(a.acknowledged_by) AS acknowledged_by,
  max(a.note) AS note
FROM numbered AS m
LEFT JOIN alarm_acknowledgement AS a ON a.vehicle = m.vehicle AND a.stream = m.stream AND a.seq = m.seq
WHERE m.alarming = 1
GROUP BY m.vehicle, m.clutch, m.alarm_number
"""

# What pretends to come from a vehicle and does not; acknowledging the messages clears it.
_IDENTITY_ALARM = """
CREATE VIEW identity_alarm AS
SELECT q.vehicle, min(q.received_at) AS raised_at, max(q.received_at) AS last_at, count(*) AS message_count,
  max(q.detail) AS reason
FROM quarantine AS q
WHERE q.reason = 'identity' AND q.acknowledged_at IS NULL
GROUP BY q.vehicle
"""

VIEWS = (
    _CURRENT_SHIFT,
    _SHIFT_HISTORY,
    _CLUTCH_TREND,
    _RUNNING_CONDITION,
    _FLEET,
    _LAST_SEEN,
    _CLUTCH_ALARM,
    _IDENTITY_ALARM,
)


def upgrade() -> None:
    """Create what is new."""
    moment = sa.DateTime(timezone=True)
    key = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")
    op.add_column("vehicle", sa.Column("metrics", sa.Text))
    op.add_column("vehicle", sa.Column("metrics_at", moment))
    op.add_column("quarantine", sa.Column("acknowledged_at", moment))
    op.add_column("quarantine", sa.Column("acknowledged_by", sa.Text))
    op.create_table(
        "fluid_fill",
        sa.Column("vehicle", sa.Text, sa.ForeignKey("vehicle.vehicle"), primary_key=True),
        sa.Column("filled_at", moment, primary_key=True),
        sa.Column("odometer_m", sa.Double),
        sa.Column("product", sa.Text, nullable=False),
        sa.Column("note", sa.Text),
    )
    op.create_table(
        "alarm_acknowledgement",
        sa.Column("vehicle", sa.Text, primary_key=True),
        sa.Column("stream", key, primary_key=True),
        sa.Column("seq", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("acknowledged_at", moment, nullable=False),
        sa.Column("acknowledged_by", sa.Text, nullable=False),
        sa.Column("note", sa.Text),
    )
    alarming = sa.text("condition = 'change_fluid'")
    op.create_index(
        "shift_alarming",
        "shift_result",
        ["vehicle", "clutch"],
        postgresql_where=alarming,
        sqlite_where=alarming,
    )
    for view in VIEWS:
        op.execute(view)
