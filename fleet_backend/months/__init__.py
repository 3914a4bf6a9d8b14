"""Results in PostgreSQL by months: partitions, the move into them, and what goes when it is old."""
