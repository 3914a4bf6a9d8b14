"""One drive from a scenario to frames."""
