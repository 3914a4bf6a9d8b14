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

RUNNING_COLUMNS: Final = """
  s.vehicle, s.clutch, s.condition, s.condition_reason, s.level_ratio, s.advice, s.running_shift_count AS shift_count,
  s.running_mu_c AS mu_c, s.running_mu_s AS mu_s, s.running_std_mu_c AS std_mu_c, s.running_std_mu_s AS std_mu_s,
  s.running_correlation AS correlation, s.running_slope_s_rad AS slope_s_rad,
  s.running_std_slope_s_rad AS std_slope_s_rad, s.running_probability_negative_slope AS probability_negative_slope,
  s.odometer_m, s.end_at, s.produced_at, s.stream, s.seq, s.algorithm_version, s.calibration_version, s.tier
"""
_RUNNING_CONDITION: Final = f"""
CREATE VIEW running_condition AS
SELECT {RUNNING_COLUMNS},
  s.running_correlation * s.running_std_mu_c * s.running_std_mu_s AS covariance_mu_c_mu_s,
  {{happened_at}} AS happened_at, {{fluid_since}} AS fluid_since
FROM {{last_results}}
"""  # noqa: S608 - of our own texts
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
LAST_BY_MONTH: Final = """clutch AS k
CROSS JOIN LATERAL (
  SELECT * FROM clutch_stream AS e WHERE e.vehicle = k.vehicle AND e.clutch = k.clutch
  ORDER BY e.last_at DESC, e.stream DESC LIMIT 1
) AS p
CROSS JOIN LATERAL (
  SELECT * FROM shift_result AS r
  WHERE r.vehicle = k.vehicle AND r.stream = p.stream AND r.seq = p.last_seq
    AND r.version_rank = p.last_version_rank AND r.produced_at = p.last_produced_at
  LIMIT 1
) AS s {where}"""

_FLEET: Final = """
CREATE VIEW fleet_worst_first AS
SELECT row_number() OVER (
  ORDER BY w.severity DESC, CASE w.severity WHEN 0 THEN coalesce(w.tier, 1) ELSE 1 END,
  coalesce(w.probability_negative_slope, 0.0) DESC, coalesce(w.level_ratio, 9.0),
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
    "running_since": "datetime(h.running_since_bus_ns / 1000000000, 'unixepoch')",
}
_BY_MONTH: Final = {
    # Of two contents under one key, which nobody should send, in two months: the one that wins inside a month.
    "is_newer": "newer.version_rank >= s.version_rank"
    " AND (newer.version_rank > s.version_rank OR newer.content_digest < s.content_digest)",
    "last_results": LAST_BY_MONTH,
    "seen_last": "SELECT max(e.last_at) FROM clutch_stream AS e WHERE e.vehicle = v.vehicle",
    "running_since": "to_timestamp(h.running_since_bus_ns / 1e9)",
}
_VIEWS: Final = (
    *(_CURRENT_SHIFT, _SHIFT_HISTORY, _CLUTCH_TREND, _RUNNING_CONDITION, _FLEET, _LAST_SEEN, _IDENTITY_ALARM),
)


def make_views(connection: Connection) -> None:
    """Make all views, in the place of those that are there."""
    for name in reversed([view.split()[2] for view in _VIEWS]):
        connection.exec_driver_sql(f"DROP VIEW IF EXISTS {name}")
    rank = RANKED_AT[connection.dialect.name]
    times = {f"{alias}_at": rank.format(f"{alias}.") for alias in _ALIASES}
    parts = _BY_MONTH if connection.dialect.name == "postgresql" else _ONE_TABLE
    words = {name: part.format(where="", **times) for name, part in parts.items()} | times
    words |= {"happened_at": _HAPPENED_AT, "fluid_since": _FLUID_SINCE}
    for view in _VIEWS:
        connection.exec_driver_sql(view.format(**words))
