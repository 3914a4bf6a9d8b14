"""Pytest plugins; tests/conftest.py names those that every run loads."""
