"""Logs of every format, read whatever is damaged and counted."""
