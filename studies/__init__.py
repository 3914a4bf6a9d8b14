"""What makes the figures of speed, size and accuracy: ``python -m studies.NAME``, with ``--short`` in two minutes."""

from clutchdiag_io.program import choose_kernel_cache, reckon_in_one_thread

reckon_in_one_thread()  # as the programs do
choose_kernel_cache()
