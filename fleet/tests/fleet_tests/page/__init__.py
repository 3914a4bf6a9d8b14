"""The fleet's page, without server and database."""
