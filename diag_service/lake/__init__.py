"""Logs in any store become a lake: Parquet by date and vehicle, and a manifest of what was made of which log."""
