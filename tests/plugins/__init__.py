"""Pytest plugins; conftest.py names those that every run loads."""
