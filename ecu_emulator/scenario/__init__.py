"""Scenarios: everything that decides what one drive puts on the bus."""
