"""In PostgreSQL: views that open the months which they need; a stream's clutch is checked, not that of each result."""

from collections.abc import Sequence
from typing import Final

from alembic import op
from sqlalchemy import inspect

revision: str = "r0010"
down_revision: str | None = "r0009"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None

# LIMIT keeps PostgreSQL from joining all months at once: one look into one part per clutch, however many there are.
_RUNNING_CONDITION: Final = """
CREATE OR REPLACE VIEW running_condition AS
SELECT
  k.vehicle, k.clutch, s.condition, s.condition_reason, s.level_ratio, s.advice, s.running_shift_count AS shift_count,
  s.running_mu_c AS mu_c, s.running_mu_s AS mu_s, s.running_std_mu_c AS std_mu_c, s.running_std_mu_s AS std_mu_s,
  s.running_correlation AS correlation,
  s.running_correlation * s.running_std_mu_c * s.running_std_mu_s AS covariance_mu_c_mu_s,
  s.running_slope_s_rad AS slope_s_rad, s.running_std_slope_s_rad AS std_slope_s_rad,
  s.running_probability_negative_slope AS probability_negative_slope,
  s.odometer_m, s.end_at, s.produced_at, s.stream, s.seq, s.algorithm_version, s.calibration_version
FROM clutch AS k
CROSS JOIN LATERAL (
  SELECT * FROM clutch_stream AS e WHERE e.vehicle = k.vehicle AND e.clutch = k.clutch
  ORDER BY e.last_at DESC, e.stream DESC LIMIT 1
) AS p
CROSS JOIN LATERAL (
  SELECT * FROM shift_result AS r
  WHERE r.vehicle = k.vehicle AND r.stream = p.stream AND r.seq = p.last_seq
    AND r.version_rank = p.last_version_rank AND r.produced_at = p.last_produced_at
  LIMIT 1
) AS s
"""
_LAST_SEEN: Final = """
CREATE OR REPLACE VIEW last_seen AS
SELECT v.vehicle, v.is_online, v.connected_at, v.service_version, v.metrics_at, (
  SELECT max(e.last_at) FROM clutch_stream AS e WHERE e.vehicle = v.vehicle
) AS last_result_at
FROM vehicle AS v
"""
# A block has the 1024 positions of locations.BLOCK, which can change with the tables and views only.
# Runs of verdicts that say change_fluid, from those blocks alone that hold such a verdict, and from those behind them
# up to one that certainly holds another: in which there is one version of each result, and none that was replaced.
CLUTCH_ALARM: Final = """
CREATE OR REPLACE VIEW clutch_alarm AS
WITH blocks AS (
  SELECT b.vehicle, b.clutch, b.stream, b.block, bool_or(b.condition = 'change_fluid') AS is_alarming,
    bool_or(b.condition <> 'no_verdict') AND min(b.version_rank) = max(b.version_rank) AND min(b.month) = max(b.month)
      AND NOT bool_or(b.condition = 'change_fluid') AS is_calm
  FROM clutch_block AS b
  WHERE b.vehicle IN (SELECT a.vehicle FROM clutch_block AS a WHERE a.condition = 'change_fluid')
  GROUP BY b.vehicle, b.clutch, b.stream, b.block
), placed AS (
  SELECT o.*, count(*) FILTER (WHERE o.is_alarming) OVER (
    PARTITION BY o.vehicle, o.clutch ORDER BY o.stream_last_at, o.stream, o.block
  ) AS alarming_count
  FROM (
    SELECT b.*, t.stream_last_at
    FROM blocks AS b
    JOIN (
      SELECT e.vehicle, e.stream, max(e.last_at) AS stream_last_at FROM clutch_stream AS e GROUP BY e.vehicle, e.stream
    ) AS t ON t.vehicle = b.vehicle AND t.stream = b.stream
  ) AS o
), counted AS (
  SELECT p.*, count(*) FILTER (WHERE p.is_calm) OVER (
    PARTITION BY p.vehicle, p.clutch, p.alarming_count ORDER BY p.stream_last_at, p.stream, p.block
  ) AS calm_count
  FROM placed AS p
), history AS (
  SELECT c.vehicle, c.clutch, c.stream, s.seq, s.end_at, s.condition, s.condition_reason, row_number() OVER (
    PARTITION BY c.vehicle, c.clutch ORDER BY c.stream_last_at, c.stream, s.seq
  ) AS shift_number
  FROM counted AS c
  CROSS JOIN LATERAL (
    SELECT DISTINCT ON (r.seq) r.seq, r.clutch, r.end_at, r.condition, r.condition_reason
    FROM (
      SELECT DISTINCT m.month FROM clutch_block AS m
      WHERE m.vehicle = c.vehicle AND m.stream = c.stream AND m.block = c.block
    ) AS n
    CROSS JOIN LATERAL (
      SELECT * FROM shift_result AS t
      WHERE t.vehicle = c.vehicle AND t.stream = c.stream
        AND t.seq >= c.block * 1024 AND t.seq < (c.block + 1) * 1024
        AND t.produced_at >= n.month::timestamp AT TIME ZONE 'UTC'
        AND t.produced_at < (n.month + interval '1 month') AT TIME ZONE 'UTC'
      OFFSET 0
    ) AS r
    ORDER BY r.seq, r.version_rank DESC, r.content_digest
  ) AS s
  WHERE s.clutch = c.clutch AND (c.is_alarming OR c.alarming_count > 0 AND c.calm_count <= c.is_calm::int)
), verdicts AS (
  SELECT g.vehicle, g.clutch, g.stream, g.seq, g.end_at, g.shift_number, g.condition_reason,
    CASE g.condition WHEN 'change_fluid' THEN 1 ELSE 0 END AS alarming
  FROM history AS g
  WHERE g.condition <> 'no_verdict'
), neighbours AS (
  SELECT v.*,
    coalesce(lag(v.alarming) OVER w, 0) AS was_alarming,
    lead(v.alarming) OVER w AS will_alarm, lead(v.end_at) OVER w AS next_end_at
  FROM verdicts AS v
  WINDOW w AS (PARTITION BY v.vehicle, v.clutch ORDER BY v.shift_number)
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


def upgrade() -> None:
    """Change the views in a moment; what reads them is not kept waiting for longer."""
    connection = op.get_bind()
    if connection.dialect.name != "postgresql":
        return
    connection.exec_driver_sql("SET LOCAL lock_timeout = '400ms'")
    # clutch_stream has the same: once for a stream, where each result took a look at its clutch and a lock of it.
    (key,) = inspect(connection).get_foreign_keys("shift_result")
    connection.exec_driver_sql(f"ALTER TABLE shift_result DROP CONSTRAINT {key['name']}")
    for view in (_RUNNING_CONDITION, _LAST_SEEN, CLUTCH_ALARM):
        connection.exec_driver_sql(view)
