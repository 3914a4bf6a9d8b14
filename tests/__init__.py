"""All tests and their tools."""

from clutchdiag_io.program import reckon_in_one_thread
from clutchdiag_io.starting import choose_kernel_cache

choose_kernel_cache()  # as programs do, before anything loads numba
reckon_in_one_thread()  # likewise, before numpy
