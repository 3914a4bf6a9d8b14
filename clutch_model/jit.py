"""The one way this project compiles a numerical kernel."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function to machine code, cached on disk and free of the interpreter lock.

    Typed wrapper around ``numba.njit``: the signature survives, so ``mypy --strict`` sees through it.
    """
    return cast("Callable[P, R]", numba.njit(cache=True, nogil=True)(function))


def array_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel that works on arrays it is given and allocates none.

    As `kernel`, but without reference counts: kernels that call each other thousands of times per simulated second
    otherwise spend more than half of their time counting the arrays they pass on.
    """
    compiled = numba.njit(cache=True, nogil=True, _nrt=False)  # type: ignore[call-overload]  # an unlisted option
    return cast("Callable[P, R]", compiled(function))
