"""What ``decode`` writes: the signals of a log as tables, and an account of what is not in them."""
