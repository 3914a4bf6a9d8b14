"""The views of a fleet database, made anew by each migration: what can be derived has one text, here."""

from typing import Final

from sqlalchemy import Connection

from fleet_backend.schema import HAPPENED_AT, RANKED_AT

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
  SELECT c.*, max({c_at}) OVER (PARTITION BY c.vehicle, c.stream) AS stream_last_at
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
  (SELECT f.product FROM fluid_fill AS f WHERE f.vehicle = h.vehicle AND f.filled_at = h.fluid_since) AS fluid,
  h.fluid_since, coalesce({running_since} > h.fluid_since, true) AS running_is_of_fluid
FROM (
  SELECT s.*, {fluid_since} AS fluid_since FROM shift_history AS s WHERE s.status = 'valid'
) AS h
"""

_RUNNING_CONDITION: Final = """
CREATE VIEW running_condition AS
SELECT
  s.vehicle, s.clutch, s.condition, s.condition_reason, s.level_ratio, s.advice, s.running_shift_count AS shift_count,
  s.running_mu_c AS mu_c, s.running_mu_s AS mu_s, s.running_std_mu_c AS std_mu_c, s.running_std_mu_s AS std_mu_s,
  s.running_correlation AS correlation,
  s.running_correlation * s.running_std_mu_c * s.running_std_mu_s AS covariance_mu_c_mu_s,
  s.running_slope_s_rad AS slope_s_rad, s.running_std_slope_s_rad AS std_slope_s_rad,
  s.running_probability_negative_slope AS probability_negative_slope,
  s.odometer_m, s.end_at, s.produced_at, s.stream, s.seq, s.algorithm_version, s.calibration_version,
  {happened_at} AS happened_at, {fluid_since} AS fluid_since
FROM {last_results}
"""
# One index look-up per clutch; CROSS JOIN keeps SQLite from reading all shifts first.
LAST_RESULTS: Final = """(
  SELECT q.vehicle, q.clutch, q.stream, (
    SELECT n.seq FROM shift_result AS n
    WHERE n.vehicle = q.vehicle AND n.stream = q.stream AND n.clutch = q.clutch
    ORDER BY n.vehicle DESC, n.stream DESC, n.seq DESC LIMIT 1
  ) AS seq
  FROM (
    SELECT k.vehicle, k.clutch, (
      SELECT l.stream FROM shift_result AS l
      WHERE l.vehicle = k.vehicle AND l.clutch = k.clutch
      ORDER BY l.vehicle DESC, l.clutch DESC, {l_at} DESC, l.stream DESC LIMIT 1
    ) AS stream
    FROM clutch AS k {where}
  ) AS q
) AS p
CROSS JOIN current_shift AS s
WHERE s.vehicle = p.vehicle AND s.stream = p.stream AND s.seq = p.seq"""
# LIMIT keeps PostgreSQL from joining all months at once: one look into one part per clutch, however many there are.
_LAST_BY_MONTH: Final = """clutch AS k
CROSS JOIN LATERAL (
  SELECT * FROM clutch_stream AS e WHERE e.vehicle = k.vehicle AND e.clutch = k.clutch
  ORDER BY e.last_at DESC, e.stream DESC LIMIT 1
) AS p
CROSS JOIN LATERAL (
  SELECT * FROM shift_result AS r
  WHERE r.vehicle = k.vehicle AND r.stream = p.stream AND r.seq = p.last_seq
    AND r.version_rank = p.last_version_rank AND r.produced_at = p.last_produced_at
  LIMIT 1
) AS s"""

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
    (SELECT f.product FROM fluid_fill AS f WHERE f.vehicle = r.vehicle AND f.filled_at = r.fluid_since) AS fluid
  FROM running_condition AS r
) AS w
"""

_LAST_SEEN: Final = """
CREATE VIEW last_seen AS
SELECT v.vehicle, v.is_online, v.connected_at, v.service_version, v.metrics_at, ({seen_last}) AS last_result_at
FROM vehicle AS v
"""
_SEEN_LAST: Final = """
  SELECT max((SELECT max({s_at}) FROM shift_result AS s WHERE s.vehicle = k.vehicle AND s.clutch = k.clutch))
  FROM clutch AS k WHERE k.vehicle = v.vehicle
"""

# Runs of verdicts that say change_fluid; a shift without verdict neither raises nor clears. It reads the history of
# those vehicles alone that ever had such a verdict, which the partial index finds.
_ALARM_HISTORY: Final = """WITH streams AS (
  SELECT c.vehicle, c.clutch, c.stream, c.seq, c.end_at, c.condition, c.condition_reason,
    max({c_at}) OVER (PARTITION BY c.vehicle, c.stream) AS stream_last_at
  FROM current_shift AS c
  WHERE c.vehicle IN (SELECT a.vehicle FROM shift_result AS a WHERE a.condition = 'change_fluid')
), history AS (
  SELECT h.*, row_number() OVER (
    PARTITION BY h.vehicle, h.clutch ORDER BY h.stream_last_at, h.stream, h.seq
  ) AS shift_number
  FROM streams AS h"""
# From those blocks alone that hold such a verdict: each of them and what follows up to one that certainly holds another
# (there is one version of each result in it, and none that was replaced), if need be in later streams. A block has the
# 1024 positions of schema.BLOCK. A stream begins at block -1 and cannot go on behind the one of the last position.
_ALARM_HISTORY_BY_BLOCKS: Final = """WITH places AS (
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
  WHERE s.clutch = c.clutch AND c.calm_count = 0"""
_ALARMS: Final = """
CREATE VIEW clutch_alarm AS
{history}
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
_HAPPENED_AT: Final = HAPPENED_AT.format("s.")
_FLUID_SINCE: Final = (
    f"(SELECT max(f.filled_at) FROM fluid_fill AS f WHERE f.vehicle = s.vehicle AND f.filled_at <= {_HAPPENED_AT})"  # noqa: S608
)
_ALIASES: Final = ("c", "l", "s")
_ONE_TABLE: Final = {
    "is_newer": "newer.version_rank > s.version_rank",
    "last_results": LAST_RESULTS,
    "seen_last": _SEEN_LAST,
    "history": _ALARM_HISTORY,
    "running_since": "datetime(h.running_since_bus_ns / 1000000000, 'unixepoch')",
}
_BY_MONTH: Final = {
    # Of two contents under one key, which nobody should send, in two months: the one that wins inside a month.
    "is_newer": "newer.version_rank >= s.version_rank"
    " AND (newer.version_rank > s.version_rank OR newer.content_digest < s.content_digest)",
    "last_results": _LAST_BY_MONTH,
    "seen_last": "SELECT max(e.last_at) FROM clutch_stream AS e WHERE e.vehicle = v.vehicle",
    "history": _ALARM_HISTORY_BY_BLOCKS,
    "running_since": "to_timestamp(h.running_since_bus_ns / 1e9)",
}
_VIEWS: Final = (
    *(_CURRENT_SHIFT, _SHIFT_HISTORY, _CLUTCH_TREND, _RUNNING_CONDITION, _FLEET, _LAST_SEEN, _ALARMS, _IDENTITY_ALARM),
)


def make_views(connection: Connection) -> None:
    """Make all views, in the place of those that are there."""
    for name in reversed([one.split()[2] for one in _VIEWS]):
        connection.exec_driver_sql(f"DROP VIEW IF EXISTS {name}")
    rank = RANKED_AT[connection.dialect.name]
    times = {f"{alias}_at": rank.format(f"{alias}.") for alias in _ALIASES}
    parts = _BY_MONTH if connection.dialect.name == "postgresql" else _ONE_TABLE
    words = {name: part.format(where="", **times) for name, part in parts.items()} | times
    words |= {"happened_at": _HAPPENED_AT, "fluid_since": _FLUID_SINCE}
    for view in _VIEWS:
        connection.exec_driver_sql(view.format(**words))
