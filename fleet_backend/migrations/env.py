"""What alembic runs for every command: the migrations, inside the transaction of the connection that it was given."""

from alembic import context
from sqlalchemy import Connection

from fleet_backend.office_tables import METADATA

connection: Connection = context.config.attributes["connection"]
context.configure(
    connection=connection,
    target_metadata=METADATA,
    transaction_per_migration=False,
)
with context.begin_transaction():
    context.run_migrations()
