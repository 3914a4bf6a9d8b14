"""Whether the data of a shift can be believed: one table of limits, and every check that needs no friction."""
