"""Speed, size and accuracy figures: ``make bench``, ``make accuracy``."""
