"""Speed, size and accuracy figures: ``make bench``, ``make accuracy``."""

from program_io.one_thread import reckon_in_one_thread

reckon_in_one_thread()  # as the programs do
