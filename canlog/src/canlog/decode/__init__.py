"""Frames to signals: messages compiled to tables that a few array operations decode."""
