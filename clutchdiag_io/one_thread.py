"""Numerical libraries in one thread: their matrices are so small here that threads only wait for each other."""

import os
from typing import Final

_VARIABLES: Final = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def reckon_in_one_thread() -> None:
    """Have numpy reckon in one thread, in this process and those it starts, unless the environment says otherwise.

    It is of use only before numpy is imported. Results are the same bit by bit; on a machine with many cores, or with
    several processes at work, threads take processor time and gain none.
    """
    for name in _VARIABLES:
        os.environ.setdefault(name, "1")
