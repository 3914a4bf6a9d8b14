"""The history of the schema: one revision per change, run by alembic on SQLite and PostgreSQL alike."""
