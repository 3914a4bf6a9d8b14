"""Damage to recordings, generated, and what the service makes of it."""
