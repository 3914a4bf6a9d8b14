"""Canonical columns become shift events."""
