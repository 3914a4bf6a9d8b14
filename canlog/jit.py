"""The one way this project compiles a numerical kernel."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, ParamSpec, TypeVar, cast

import numba
from numba.core import types as numba_types

from canlog.kernel_cache import OPTIONS, LateCache

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function to machine code, cached on disk and free of the interpreter lock.

    Typed wrapper around ``numba.njit``: the signature survives, so ``mypy --strict`` sees through it.
    """
    return _compiled(function)


def array_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel that works on arrays it is given and allocates none.

    As `kernel`, but without reference counts: kernels that call each other thousands of times per simulated second
    otherwise spend more than half of their time counting the arrays they pass on.
    """
    return _compiled(function, _nrt=False)  # an unlisted option of numba.njit


def inlined_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a small part of an array kernel, which becomes part of every kernel that calls it.

    A call hands every array over as seven numbers; where a call does no more work than that, it costs half of the time.
    """
    return _compiled(function, _nrt=False, forceinline=True)


def unchecked_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile an `inlined_kernel` in which a division by zero is infinite: no check of each one is in the way.

    Products and sums are not joined, though that would be a little faster: where they are depends on what was compiled
    before, so the last digit would be another one in every cache.
    """
    return _compiled(function, forceinline=True, **_UNCHECKED)


def row_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile an `array_kernel` that goes along rows of which none waits for another: several are done at once.

    What it calls must be `unchecked_kernel`s, or small, and have no branches.
    """
    return _compiled(function, **_UNCHECKED)


_UNCHECKED: Final[dict[str, bool | str]] = {"_nrt": False, "error_model": "numpy"}


def _compiled(function: Callable[P, R], **options: bool | str) -> Callable[P, R]:
    vars(function)[OPTIONS] = options
    dispatcher: Any = numba.njit(nogil=True, no_cfunc_wrapper=True, **options)(function)  # type: ignore[call-overload]  # the unlisted option
    dispatcher._cache = LateCache(dispatcher)  # noqa: SLF001 - what njit's cache=True sets, with another key
    dispatcher.get_call_template = _whatever_the_constants(dispatcher.get_call_template)
    return cast("Callable[P, R]", dispatcher)


def _whatever_the_constants(get_call_template: Callable[..., Any]) -> Callable[..., Any]:
    """Have a kernel compiled once for all calls from other kernels: numba makes one more for each constant argument."""
    unliteral: Callable[[Any], Any] = numba_types.unliteral

    def general(args: Sequence[Any], keywords: Mapping[str, Any]) -> object:
        return get_call_template(tuple(unliteral(kind) for kind in args), keywords)

    return general
