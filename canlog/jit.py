"""The one way this project compiles a numerical kernel."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, ParamSpec, TypeVar, cast

import numba
from numba.core import types as numba_types

from canlog.kernel_cache import LateCache
from canlog.kernel_digest import OPTIONS

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


def fused_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile an `inlined_kernel` in which a product and a sum may be one step, rounded once, if the processor can.

    For what is followed from point to point and waits for each result, and for what goes along rows. Its last digit is
    the processor's, and a division by zero is infinite, no error.
    """
    return _compiled(function, forceinline=True, **_FUSED)


def row_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile an `array_kernel` that goes along rows of which none waits for another: several are done at once.

    What it calls must be `fused_kernel`s, or small, and have no branches.
    """
    return _compiled(function, **_FUSED)


_FUSED: Final[dict[str, bool | str | set[str]]] = {"_nrt": False, "fastmath": {"contract"}, "error_model": "numpy"}


def _compiled(function: Callable[P, R], **options: bool | str | set[str]) -> Callable[P, R]:
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
