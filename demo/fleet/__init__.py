"""A fleet on one machine: broker, database, ingest workers and vehicles with different fluids."""
