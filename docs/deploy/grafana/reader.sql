-- The role by which Grafana reads the fleet database: it reads every table and view and writes none. A new database of
-- docker-compose.yml gets it by itself; to an older one it is added by hand, once.
CREATE ROLE grafana LOGIN CONNECTION LIMIT 20;
GRANT pg_read_all_data TO grafana;
ALTER ROLE grafana SET default_transaction_read_only = on;
ALTER ROLE grafana SET statement_timeout = '30s';
ALTER ROLE grafana SET jit = off; -- with many months compiling a question takes longer than answering it
