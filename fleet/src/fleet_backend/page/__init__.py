"""The fleet's page: a web server that shows what the database knows, for people and for programs."""
