"""All tests and their tools."""

from clutchdiag_io.program import choose_kernel_cache, reckon_in_one_thread

choose_kernel_cache()  # as programs do, before anything loads numba
reckon_in_one_thread()  # likewise, before numpy
