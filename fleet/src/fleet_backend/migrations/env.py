"""What alembic runs for every command: the migrations, inside the transaction of the connection that it was given."""

from alembic import context
from sqlalchemy import Connection

connection: Connection = context.config.attributes["connection"]
context.configure(
    connection=connection,
    transaction_per_migration=False,
)
with context.begin_transaction():
    context.run_migrations()
