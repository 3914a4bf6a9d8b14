"""From canonical columns to results: pure, without clock, file or socket."""
