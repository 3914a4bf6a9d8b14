"""Frames become canonical columns."""
