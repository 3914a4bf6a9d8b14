"""Writers of the log formats; all take columns."""
