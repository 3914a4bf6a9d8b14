-- Ten questions to a lake, for DuckDB in the folder that holds it: duckdb < lake.sql
-- For a store begin with INSTALL httpfs; LOAD httpfs; (from the internet, not tested) and write its address before the names.

CREATE VIEW shifts AS
SELECT * FROM read_parquet('lake/shifts/*/*/*.parquet', hive_partitioning = true, hive_types = {'date': DATE, 'vehicle': VARCHAR});
CREATE VIEW logs AS
SELECT * FROM read_parquet('lake/manifest/**/*.parquet', filename = true, union_by_name = true)
QUALIFY row_number() OVER (PARTITION BY source ORDER BY parse_filename(filename) DESC) = 1;

-- What is in it?
SELECT vehicle, min(date) AS first, max(date) AS last, count(DISTINCT stream) AS logs, count(*) AS shifts FROM shifts GROUP BY vehicle ORDER BY vehicle;

-- Which logs could not be analysed, and why?
SELECT vehicle, source, reason FROM logs WHERE outcome = 'failed' ORDER BY vehicle, source;

-- Which clutches need attention, going by the last shift of each?
SELECT vehicle, clutch, end_utc, "verdict.condition", "verdict.advice" FROM shifts
QUALIFY row_number() OVER (PARTITION BY vehicle, clutch ORDER BY end_utc DESC) = 1 ORDER BY "verdict.level_ratio";

-- How did the friction of a clutch go, by the last shift of each drive?
SELECT date, arg_max("verdict.friction.mu_c", end_utc) AS mu_c, arg_max("verdict.friction.std_mu_c", end_utc) AS std_mu_c FROM shifts
WHERE vehicle = 'car1' AND clutch = 1 GROUP BY date ORDER BY date;

-- What is usual among the vehicles?
SELECT clutch, quantile_cont("friction.mu_c", [0.05, 0.5, 0.95]) AS mu_c, count(*) AS shifts FROM shifts WHERE status = 'valid' GROUP BY clutch ORDER BY clutch;

-- What did a vehicle do in some minutes?
SELECT start_utc, from_gear, to_gear, duration_s, status FROM shifts
WHERE vehicle = 'car1' AND date = '2026-01-01' AND start_utc BETWEEN '2026-01-01 00:00:00+00' AND '2026-01-01 00:10:00+00' ORDER BY start_utc;

-- Why do shifts give no friction?
SELECT unnest(string_split(reasons, ';')) AS reason, count(*) AS shifts FROM shifts WHERE status <> 'valid' GROUP BY reason ORDER BY shifts DESC;

-- Does friction depend on the temperature of the oil?
SELECT 10 * round((sump_temperature_k - 273.15) / 10) AS oil_degc, clutch, avg("friction.mu_c") AS mu_c, count(*) AS shifts FROM shifts
WHERE status = 'valid' GROUP BY ALL ORDER BY ALL;

-- Which results are of an older algorithm than the newest?
SELECT algorithm_version, settings, count(*) AS logs, min(made_at) AS since FROM logs WHERE outcome = 'done' GROUP BY ALL ORDER BY since;

-- What did a signal do during a shift of a lake with --signals 'EngineSpeed'?
CREATE VIEW signals AS
SELECT * FROM read_parquet('lake/signals/*/*/*.parquet', union_by_name = true, hive_types = {'date': DATE, 'vehicle': VARCHAR});
SELECT s.number, s.to_gear, count(*) AS frames, max(f."ECM_TorqueSpeed.EngineSpeed") AS highest_rpm
FROM shifts AS s JOIN signals AS f ON f.vehicle = s.vehicle AND f.date = s.date AND f.time BETWEEN s.start_utc AND s.end_utc
WHERE s.vehicle = 'car1' AND f."ECM_TorqueSpeed.EngineSpeed" IS NOT NULL GROUP BY ALL ORDER BY s.number;
