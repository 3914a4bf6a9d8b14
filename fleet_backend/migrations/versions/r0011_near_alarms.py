"""In PostgreSQL: runs of verdicts without a look at those blocks of results that lie far from any alarming one."""

from collections.abc import Sequence
from typing import Final

from alembic import op

from fleet_backend.migrations.versions.r0010_near_views import CLUTCH_ALARM

revision: str = "r0011"
down_revision: str | None = "r0010"
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None

# The blocks that were read before, found from the alarming ones on: each of these and what follows up to a calm block,
# if need be in later streams. A stream begins at block -1 and cannot go on behind the one of the last position.
_BLOCKS: Final = """
CREATE OR REPLACE VIEW clutch_alarm AS
WITH places AS (
  SELECT o.vehicle, o.clutch, o.stream, o.stream_last_at, p.block,
    lead(p.block) OVER (PARTITION BY o.vehicle, o.clutch, o.stream ORDER BY p.block) AS next_block,
    count(*) FILTER (WHERE p.block >= 0) OVER (
      PARTITION BY o.vehicle, o.clutch ORDER BY o.stream_last_at, o.stream, p.block
    ) AS alarming_count
  FROM (
    SELECT e.vehicle, e.clutch, e.stream, max(e.last_at) OVER (PARTITION BY e.vehicle, e.stream) AS stream_last_at
    FROM clutch_stream AS e
    WHERE e.vehicle IN (SELECT a.vehicle FROM clutch_block AS a WHERE a.condition = 'change_fluid')
  ) AS o
  LEFT JOIN (
    SELECT b.vehicle, b.clutch, b.stream, array_agg(DISTINCT b.block) AS blocks
    FROM clutch_block AS b
    WHERE b.condition = 'change_fluid'
    GROUP BY b.vehicle, b.clutch, b.stream
  ) AS a ON a.vehicle = o.vehicle AND a.clutch = o.clutch AND a.stream = o.stream
  CROSS JOIN LATERAL unnest(-1::bigint || a.blocks) AS p (block)
), stretches AS (
  SELECT p.*, coalesce(k.block, p.next_block - 1, 9007199254740991) AS last_block, count(k.block) OVER (
    PARTITION BY p.vehicle, p.clutch, p.alarming_count ORDER BY p.stream_last_at, p.stream, p.block
    ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING
  ) AS calm_count
  FROM places AS p
  LEFT JOIN LATERAL (
    SELECT b.block
    FROM clutch_block AS b
    WHERE b.vehicle = p.vehicle AND b.clutch = p.clutch AND b.stream = p.stream
      AND b.block > p.block AND b.block <= coalesce(p.next_block - 1, 9007199254740991)
    GROUP BY b.block
    HAVING bool_or(b.condition <> 'no_verdict') AND min(b.version_rank) = max(b.version_rank)
      AND min(b.month) = max(b.month)
    ORDER BY b.block
    LIMIT 1
  ) AS k ON true
  WHERE p.alarming_count > 0
), history AS (
  SELECT c.vehicle, c.clutch, c.stream, s.seq, s.end_at, s.condition, s.condition_reason, row_number() OVER (
    PARTITION BY c.vehicle, c.clutch ORDER BY c.stream_last_at, c.stream, s.seq
  ) AS shift_number
  FROM stretches AS c
  CROSS JOIN LATERAL (
    SELECT DISTINCT ON (r.seq) r.seq, r.clutch, r.end_at, r.condition, r.condition_reason
    FROM (
      SELECT DISTINCT m.month FROM clutch_block AS m
      WHERE m.vehicle = c.vehicle AND m.stream = c.stream AND m.block BETWEEN c.block AND c.last_block
    ) AS n
    CROSS JOIN LATERAL (
      SELECT * FROM shift_result AS t
      WHERE t.vehicle = c.vehicle AND t.stream = c.stream
        AND t.seq BETWEEN c.block * 1024 AND c.last_block * 1024 + 1023
        AND t.produced_at >= n.month::timestamp AT TIME ZONE 'UTC'
        AND t.produced_at < (n.month + interval '1 month') AT TIME ZONE 'UTC'
      OFFSET 0
    ) AS r
    ORDER BY r.seq, r.version_rank DESC, r.content_digest
  ) AS s
  WHERE s.clutch = c.clutch AND c.calm_count = 0
"""


def upgrade() -> None:
    """Change the view in a moment; what reads it is not kept waiting for longer."""
    connection = op.get_bind()
    if connection.dialect.name != "postgresql":
        return
    connection.exec_driver_sql("SET LOCAL lock_timeout = '400ms'")
    connection.exec_driver_sql(_BLOCKS + CLUTCH_ALARM[CLUTCH_ALARM.index("), verdicts AS (") :])
