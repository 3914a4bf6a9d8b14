-- A result store as the first schema version wrote it; one of its three results is delivered.
PRAGMA application_id = 1129071689;
PRAGMA user_version = 1;
BEGIN TRANSACTION;
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
INSERT INTO "meta" VALUES('stream','0b54b51f-6c0c-4b2c-8a6b-3f7a4c1f2d10');
CREATE TABLE result (
  position INTEGER PRIMARY KEY AUTOINCREMENT,
  vehicle TEXT NOT NULL,
  stream TEXT NOT NULL,
  seq INTEGER NOT NULL,
  algorithm_version TEXT NOT NULL,
  calibration_version TEXT NOT NULL,
  clutch INTEGER NOT NULL,
  json TEXT NOT NULL,
  published INTEGER NOT NULL DEFAULT 0,
  UNIQUE (vehicle, stream, seq, algorithm_version, calibration_version)
);
INSERT INTO "result" VALUES(1,'car1','0b54b51f-6c0c-4b2c-8a6b-3f7a4c1f2d10',1,'algorithm-1','1+0123456789ab',2,'{"schema":"clutchdiag/shift/v1","vehicle":"car1","stream":"0b54b51f-6c0c-4b2c-8a6b-3f7a4c1f2d10","seq":1,"number":1,"produced_at":"2026-01-01T00:00:05.000000Z","start_utc":"2026-01-01T00:00:00.123456Z","end_utc":"2026-01-01T00:00:01.023456Z","start_bus_ns":1767225600123456000,"end_bus_ns":1767225601023456000,"duration_s":0.9,"from_gear":1,"to_gear":2,"clutch":2,"status":"valid","reasons":[],"friction":{"mu_c":0.1361,"mu_s":0.12000000000000001,"std_mu_c":0.0012,"std_mu_s":0.0016,"correlation":0.4,"random_std_mu_c":0.0007,"random_std_mu_s":0.0011,"slope_s_rad":0.0021,"std_slope_s_rad":0.0003,"probability_negative_slope":1e-09},"sample_count":31,"window_s":0.31,"chi_square_ratio":0.97,"quality":0.9,"sump_temperature_k":353.15,"clutch_temperature_k":361.0,"slip_energy_j":8400.0,"odometer_m":1234.0,"verdict":{"clutch":2,"condition":"good","reason":"mu-v slope negative with probability 0.000","level_ratio":0.99,"friction":{"mu_c":0.1361,"mu_s":0.12000000000000001,"std_mu_c":0.0012,"std_mu_s":0.0016,"correlation":0.4,"random_std_mu_c":0.0007,"random_std_mu_s":0.0011,"slope_s_rad":0.0021,"std_slope_s_rad":0.0003,"probability_negative_slope":1e-09},"shift_count":1},"algorithm_version":"algorithm-1","calibration_version":"1+0123456789ab"}',1);
INSERT INTO "result" VALUES(2,'car1','0b54b51f-6c0c-4b2c-8a6b-3f7a4c1f2d10',2,'algorithm-1','1+0123456789ab',2,'{"schema":"clutchdiag/shift/v1","vehicle":"car1","stream":"0b54b51f-6c0c-4b2c-8a6b-3f7a4c1f2d10","seq":2,"number":2,"produced_at":"2026-01-01T00:00:05.000000Z","start_utc":"2026-01-01T00:00:04.123456Z","end_utc":"2026-01-01T00:00:05.023456Z","start_bus_ns":1767225604123456000,"end_bus_ns":1767225605023456000,"duration_s":0.9,"from_gear":1,"to_gear":2,"clutch":2,"status":"valid","reasons":[],"friction":{"mu_c":0.1361,"mu_s":0.12000000000000001,"std_mu_c":0.0012,"std_mu_s":0.0016,"correlation":0.4,"random_std_mu_c":0.0007,"random_std_mu_s":0.0011,"slope_s_rad":0.0021,"std_slope_s_rad":0.0003,"probability_negative_slope":1e-09},"sample_count":31,"window_s":0.31,"chi_square_ratio":0.97,"quality":0.9,"sump_temperature_k":353.15,"clutch_temperature_k":361.0,"slip_energy_j":8400.0,"odometer_m":1234.0,"verdict":{"clutch":2,"condition":"good","reason":"mu-v slope negative with probability 0.000","level_ratio":0.99,"friction":{"mu_c":0.1361,"mu_s":0.12000000000000001,"std_mu_c":0.0012,"std_mu_s":0.0016,"correlation":0.4,"random_std_mu_c":0.0007,"random_std_mu_s":0.0011,"slope_s_rad":0.0021,"std_slope_s_rad":0.0003,"probability_negative_slope":1e-09},"shift_count":2},"algorithm_version":"algorithm-1","calibration_version":"1+0123456789ab"}',0);
INSERT INTO "result" VALUES(3,'car1','0b54b51f-6c0c-4b2c-8a6b-3f7a4c1f2d10',3,'algorithm-1','1+0123456789ab',2,'{"schema":"clutchdiag/shift/v1","vehicle":"car1","stream":"0b54b51f-6c0c-4b2c-8a6b-3f7a4c1f2d10","seq":3,"number":3,"produced_at":"2026-01-01T00:00:05.000000Z","start_utc":"2026-01-01T00:00:08.123456Z","end_utc":"2026-01-01T00:00:09.023456Z","start_bus_ns":1767225608123456000,"end_bus_ns":1767225609023456000,"duration_s":0.9,"from_gear":1,"to_gear":2,"clutch":2,"status":"valid","reasons":[],"friction":{"mu_c":0.1361,"mu_s":0.12000000000000001,"std_mu_c":0.0012,"std_mu_s":0.0016,"correlation":0.4,"random_std_mu_c":0.0007,"random_std_mu_s":0.0011,"slope_s_rad":0.0021,"std_slope_s_rad":0.0003,"probability_negative_slope":1e-09},"sample_count":31,"window_s":0.31,"chi_square_ratio":0.97,"quality":0.9,"sump_temperature_k":353.15,"clutch_temperature_k":361.0,"slip_energy_j":8400.0,"odometer_m":1234.0,"verdict":{"clutch":2,"condition":"good","reason":"mu-v slope negative with probability 0.000","level_ratio":0.99,"friction":{"mu_c":0.1361,"mu_s":0.12000000000000001,"std_mu_c":0.0012,"std_mu_s":0.0016,"correlation":0.4,"random_std_mu_c":0.0007,"random_std_mu_s":0.0011,"slope_s_rad":0.0021,"std_slope_s_rad":0.0003,"probability_negative_slope":1e-09},"shift_count":3},"algorithm_version":"algorithm-1","calibration_version":"1+0123456789ab"}',0);
CREATE TABLE state (
  vehicle TEXT PRIMARY KEY,
  belief TEXT NOT NULL,
  condition TEXT NOT NULL,
  algorithm_version TEXT NOT NULL,
  calibration_version TEXT NOT NULL
);
INSERT INTO "state" VALUES('car1','{"mark":1}','{}','a','c');
CREATE INDEX unpublished ON result (vehicle, position) WHERE published = 0;
CREATE INDEX latest ON result (vehicle, clutch, position);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('result',3);
COMMIT;
