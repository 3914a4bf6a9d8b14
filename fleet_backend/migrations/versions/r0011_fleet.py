"""The tables and views of a fleet; in PostgreSQL results by months, with the tables that tell in which ones they are.

Databases of earlier schemas are those of clutchdiag 0.7 and before: clutchdiag 0.8 brings them here.
"""

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Final

from alembic import op

from fleet_backend.months import AHEAD_MONTHS, FOLLOW, MAKE, make_partitions, month_of, months_on

revision: str = "r0011"
down_revision: str | None = None
branch_labels: Sequence[str] | None = None
depends_on: Sequence[str] | None = None

# Words of SQL in which the two databases differ.
_SQLITE: Final = {
    "moment": "DATETIME",
    "double": "DOUBLE",
    "key": "TEXT",
    "key_end": "",
    "clutches": ",\n  FOREIGN KEY (vehicle, clutch) REFERENCES clutch (vehicle, clutch)",
    "parts": "",
    "is_newer": "newer.version_rank > s.version_rank",
}
_POSTGRESQL: Final = {
    "moment": "timestamptz",
    "double": "double precision",
    "key": 'TEXT COLLATE "C"',  # sorted by bytes, as SQLite does everywhere
    "key_end": ", produced_at",
    "clutches": "",  # clutch_stream has the same: once for a stream, in place of once for each result
    "parts": "PARTITION BY RANGE (produced_at)",
    # Of two contents under one key, which nobody should send, in two months: the one that wins inside a month.
    "is_newer": "newer.version_rank >= s.version_rank"
    " AND (newer.version_rank > s.version_rank OR newer.content_digest < s.content_digest)",
}
_FRICTION: Final = (
    "{0}mu_c {double}, {0}mu_s {double}, {0}std_mu_c {double}, {0}std_mu_s {double}, {0}correlation {double},"
    " {0}random_std_mu_c {double}, {0}random_std_mu_s {double}, {0}slope_s_rad {double}, {0}std_slope_s_rad {double},"
    " {0}probability_negative_slope {double}"
)
_TABLES: Final = (
    """
CREATE TABLE vehicle (
  vehicle TEXT NOT NULL PRIMARY KEY, is_online BOOLEAN, connected_at {moment}, service_version TEXT,
  algorithm_version TEXT, calibration_version TEXT, metrics TEXT, metrics_at {moment}, controller TEXT,
  controller_at {moment}
)""",
    """
CREATE TABLE clutch (
  vehicle TEXT NOT NULL REFERENCES vehicle (vehicle), clutch SMALLINT NOT NULL, PRIMARY KEY (vehicle, clutch)
)""",
    f"""
CREATE TABLE shift_result (
  vehicle TEXT NOT NULL, stream {{key}} NOT NULL, seq BIGINT NOT NULL, version_rank {{key}} NOT NULL,
  algorithm_version TEXT NOT NULL, calibration_version TEXT NOT NULL, clutch SMALLINT NOT NULL, number BIGINT NOT NULL,
  produced_at {{moment}} NOT NULL, start_at {{moment}} NOT NULL, end_at {{moment}} NOT NULL,
  start_bus_ns BIGINT NOT NULL, end_bus_ns BIGINT NOT NULL, duration_s {{double}} NOT NULL, from_gear BIGINT NOT NULL,
  to_gear BIGINT NOT NULL, status TEXT NOT NULL, reasons TEXT NOT NULL, {_FRICTION.replace("{0}", "")},
  sample_count BIGINT NOT NULL, window_s {{double}} NOT NULL, chi_square_ratio {{double}} NOT NULL,
  quality {{double}} NOT NULL, sump_temperature_k {{double}}, clutch_temperature_k {{double}}, slip_energy_j {{double}},
  odometer_m {{double}}, condition TEXT NOT NULL, condition_reason TEXT NOT NULL, level_ratio {{double}},
  {_FRICTION.replace("{0}", "running_")},
  running_shift_count BIGINT NOT NULL, content_digest BIGINT NOT NULL,
  stored_at {{moment}} DEFAULT CURRENT_TIMESTAMP NOT NULL, kind TEXT, end_reason TEXT, advice TEXT,
  scale_free_mu_c {{double}}, scale_free_mu_s {{double}}, scale_free_std_mu_c {{double}},
  scale_free_std_mu_s {{double}}, scale_free_correlation {{double}}, trust {{double}}, trust_parts TEXT,
  PRIMARY KEY (vehicle, stream, seq, version_rank{{key_end}}){{clutches}}
) {{parts}}""",
    "CREATE INDEX shift_by_time ON shift_result (vehicle, clutch, produced_at, stream)",
    "CREATE INDEX shift_by_arrival ON shift_result (stored_at)",
    "CREATE INDEX shift_alarming ON shift_result (vehicle, clutch) WHERE condition = 'change_fluid'",
    """
CREATE TABLE clutch_month (
  vehicle TEXT NOT NULL, clutch SMALLINT NOT NULL, month DATE NOT NULL, result_count BIGINT NOT NULL,
  valid_count BIGINT NOT NULL, change_fluid_count BIGINT NOT NULL, mean_mu_c {double}, mean_mu_s {double},
  least_level_ratio {double}, last_odometer_m {double}, PRIMARY KEY (vehicle, clutch, month)
)""",
    """
CREATE TABLE quarantine (
  digest TEXT NOT NULL PRIMARY KEY, topic TEXT NOT NULL, vehicle TEXT, reason TEXT NOT NULL, detail TEXT NOT NULL,
  size_bytes BIGINT NOT NULL, head TEXT NOT NULL, received_at {moment} NOT NULL, acknowledged_at {moment},
  acknowledged_by TEXT
)""",
    "CREATE INDEX quarantine_by_time ON quarantine (received_at)",
    """
CREATE TABLE fluid_fill (
  vehicle TEXT NOT NULL REFERENCES vehicle (vehicle), filled_at {moment} NOT NULL, odometer_m {double},
  product TEXT NOT NULL, note TEXT, PRIMARY KEY (vehicle, filled_at)
)""",
    """
CREATE TABLE vehicle_lot (
  vehicle TEXT NOT NULL, name TEXT NOT NULL, value TEXT NOT NULL, PRIMARY KEY (vehicle, name)
)""",
    """
CREATE TABLE population (
  version BIGINT NOT NULL PRIMARY KEY, learned_at {moment} NOT NULL, clutch_count BIGINT NOT NULL, content TEXT NOT NULL
)""",
    """
CREATE TABLE alarm_acknowledgement (
  vehicle TEXT NOT NULL, stream {key} NOT NULL, seq BIGINT NOT NULL, acknowledged_at {moment} NOT NULL,
  acknowledged_by TEXT NOT NULL, note TEXT, PRIMARY KEY (vehicle, stream, seq)
)""",
    """
CREATE TABLE alarm (
  vehicle TEXT NOT NULL REFERENCES vehicle (vehicle), clutch SMALLINT NOT NULL, rule TEXT NOT NULL,
  number BIGINT NOT NULL, raised_at {moment} NOT NULL, cleared_at {moment}, reason TEXT NOT NULL,
  acknowledged_at {moment}, acknowledged_by TEXT, note TEXT, PRIMARY KEY (vehicle, clutch, rule, number)
)""",
    "CREATE UNIQUE INDEX alarm_open ON alarm (vehicle, clutch, rule) WHERE cleared_at IS NULL",
    "CREATE INDEX alarm_by_time ON alarm (raised_at)",
    """
CREATE TABLE alarm_message (
  key TEXT NOT NULL, carrier TEXT NOT NULL, payload TEXT NOT NULL, made_at {moment} NOT NULL,
  attempt_count BIGINT NOT NULL, next_try_at {moment} NOT NULL, claimed_until {moment}, delivered_at {moment},
  complaint TEXT, PRIMARY KEY (key, carrier)
)""",
    "CREATE INDEX alarm_message_waiting ON alarm_message (carrier, next_try_at) WHERE delivered_at IS NULL",
    """
CREATE TABLE audit (
  audit_id TEXT NOT NULL PRIMARY KEY, at {moment} NOT NULL, who TEXT NOT NULL, role TEXT NOT NULL,
  action TEXT NOT NULL, subject TEXT NOT NULL
)""",
    "CREATE INDEX audit_by_time ON audit (at)",
)

_CURRENT_SHIFT: Final = """
CREATE VIEW current_shift AS
SELECT s.*
FROM shift_result AS s
WHERE NOT EXISTS (
  SELECT 1 FROM shift_result AS newer
  WHERE newer.vehicle = s.vehicle AND newer.stream = s.stream AND newer.seq = s.seq
    AND {is_newer}
)
"""

# Clocks jump, so inside a stream only seq tells the order; streams follow each other by their last result.
_SHIFT_HISTORY: Final = """
CREATE VIEW shift_history AS
SELECT h.*, row_number() OVER (
  PARTITION BY h.vehicle, h.clutch ORDER BY h.stream_last_at, h.stream, h.seq
) AS shift_number
FROM (
  SELECT c.*, max(c.produced_at) OVER (PARTITION BY c.vehicle, c.stream) AS stream_last_at
  FROM current_shift AS c
) AS h
"""

_CLUTCH_TREND: Final = """
CREATE VIEW clutch_trend AS
SELECT
  h.vehicle, h.clutch, h.shift_number, h.odometer_m, h.end_at,
  h.mu_c, h.mu_s, h.std_mu_c, h.std_mu_s, h.random_std_mu_c, h.random_std_mu_s,
  h.correlation * h.std_mu_c * h.std_mu_s AS covariance_mu_c_mu_s,
  h.slope_s_rad, h.std_slope_s_rad, h.probability_negative_slope, h.quality, h.clutch_temperature_k,
  h.running_mu_c, h.running_std_mu_c, h.running_random_std_mu_c,
  h.running_mu_s, h.running_std_mu_s, h.running_random_std_mu_s,
  h.running_slope_s_rad, h.running_std_slope_s_rad, h.running_probability_negative_slope,
  h.condition, h.level_ratio, h.stream, h.seq, h.algorithm_version, h.calibration_version, h.kind, h.end_reason,
  (
    SELECT f.product FROM fluid_fill AS f
    WHERE f.vehicle = h.vehicle AND f.filled_at <= h.end_at
    ORDER BY f.filled_at DESC LIMIT 1
  ) AS fluid
FROM shift_history AS h
WHERE h.status = 'valid'
"""

# One index look-up per clutch; CROSS JOIN keeps SQLite from reading all shifts first.
_RUNNING_CONDITION: Final = """
CREATE VIEW running_condition AS
SELECT
  s.vehicle, s.clutch, s.condition, s.condition_reason, s.level_ratio, s.advice, s.running_shift_count AS shift_count,
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

# LIMIT keeps PostgreSQL from joining all months at once: one look into one part per clutch, however many there are.
_RUNNING_BY_MONTH: Final = """
CREATE VIEW running_condition AS
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

_FLEET: Final = """
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

_LAST_SEEN: Final = """
CREATE VIEW last_seen AS
SELECT v.vehicle, v.is_online, v.connected_at, v.service_version, v.metrics_at, (
  SELECT max((
    SELECT max(s.produced_at) FROM shift_result AS s WHERE s.vehicle = k.vehicle AND s.clutch = k.clutch
  )) FROM clutch AS k WHERE k.vehicle = v.vehicle
) AS last_result_at
FROM vehicle AS v
"""
_LAST_SEEN_BY_STREAM: Final = """
CREATE VIEW last_seen AS
SELECT v.vehicle, v.is_online, v.connected_at, v.service_version, v.metrics_at, (
  SELECT max(e.last_at) FROM clutch_stream AS e WHERE e.vehicle = v.vehicle
) AS last_result_at
FROM vehicle AS v
"""

# Runs of verdicts that say change_fluid; a shift without verdict neither raises nor clears. It reads the history of
# those vehicles alone that ever had such a verdict, which the partial index finds.
_ALARM_HISTORY: Final = """
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
"""
# From those blocks alone that hold such a verdict: each of them and what follows up to one that certainly holds another
# (there is one version of each result in it, and none that was replaced), if need be in later streams. A block has the
# 1024 positions of schema.BLOCK. A stream begins at block -1 and cannot go on behind the one of the last position.
_ALARM_HISTORY_BY_BLOCKS: Final = """
CREATE VIEW clutch_alarm AS
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
_ALARMS: Final = """
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
_IDENTITY_ALARM: Final = """
CREATE VIEW identity_alarm AS
SELECT q.vehicle, min(q.received_at) AS raised_at, max(q.received_at) AS last_at, count(*) AS message_count,
  max(q.detail) AS reason
FROM quarantine AS q
WHERE q.reason = 'identity' AND q.acknowledged_at IS NULL
GROUP BY q.vehicle
"""


def upgrade() -> None:
    """Create all."""
    connection = op.get_bind()
    is_by_month = connection.dialect.name == "postgresql"
    words = _POSTGRESQL if is_by_month else _SQLITE
    for statement in _TABLES:
        connection.exec_driver_sql(statement.format(**words))
    if is_by_month:
        this = month_of(datetime.now(UTC))
        make_partitions(connection, "shift_result", this, months_on(this, AHEAD_MONTHS + 1))
        for statement in (*MAKE, *FOLLOW):
            connection.exec_driver_sql(statement)
    for view in (
        _CURRENT_SHIFT.format(**words),
        *(_SHIFT_HISTORY, _CLUTCH_TREND),
        _RUNNING_BY_MONTH if is_by_month else _RUNNING_CONDITION,
        _FLEET,
        _LAST_SEEN_BY_STREAM if is_by_month else _LAST_SEEN,
        (_ALARM_HISTORY_BY_BLOCKS if is_by_month else _ALARM_HISTORY) + _ALARMS,
        _IDENTITY_ALARM,
    ):
        connection.exec_driver_sql(view)
