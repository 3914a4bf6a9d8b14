"""What signals of a database mean: profiles, and frames to canonical columns."""
