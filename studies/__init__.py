"""Speed, size and accuracy figures: ``make bench``, ``make accuracy``."""

from clutchdiag_io.program import reckon_in_one_thread

reckon_in_one_thread()  # as the programs do
