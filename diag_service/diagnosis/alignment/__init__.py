"""The signals of one shift on one clock and one even grid: when samples were taken, and what they read in between."""
