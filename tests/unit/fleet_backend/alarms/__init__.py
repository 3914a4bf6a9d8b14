"""Alarms by rules."""
