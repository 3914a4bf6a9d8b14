"""The one way this project compiles a numerical kernel, and how those who wait for it hear of it."""

import gc
from collections.abc import Callable
from typing import Any, Final, ParamSpec, TypeVar, cast

import numba
from numba.core import event as numba_event
from numba.extending import register_jitable

P = ParamSpec("P")
R = TypeVar("R")
FIRST_START: Final = "first start: compiling, takes about 20 s"
# No kernel makes an array: without the last option, which numba does not list, the use of each argument is counted.
_OPTIONS: Final[dict[str, Any]] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": False}
_EVENT: Final = "numba:compile"
_events: Any = numba_event  # numba has no types


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function to machine code, cached on disk and free of the interpreter lock.

    Typed wrapper around ``numba.njit``: the signature survives, so ``mypy --strict`` sees through it.
    """
    try:
        return cast("Callable[P, R]", numba.njit(cache=True, **_OPTIONS)(function))
    except RuntimeError:  # no folder can be written
        return cast("Callable[P, R]", numba.njit(**_OPTIONS)(function))


class _Uncollected(numba_event.Listener):
    """Collects no garbage while a kernel is compiled: a tenth of the time, and hardly anything is garbage before."""

    def __init__(self) -> None:
        self._depth = 0  # parts are compiled inside a kernel
        self._was_enabled = False

    def on_start(self, event: object) -> None:  # noqa: ARG002 - numba's signature
        if self._depth == 0:
            self._was_enabled = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: object) -> None:  # noqa: ARG002 - likewise
        self._depth -= 1
        if self._depth == 0 and self._was_enabled:
            gc.enable()


_events.register(_EVENT, _Uncollected())


def part(function: Callable[P, R]) -> Callable[P, R]:
    """Let kernels call a function, which becomes machine code with them; Python runs it as it stands.

    It needs no entry for Python and no file of the cache, which cost a kernel a third of its time to compile.
    """
    compiled: Callable[P, R] = register_jitable(**_OPTIONS, no_cpython_wrapper=True)(function)
    return compiled


def on_compiling(listener: Callable[[str], object]) -> Callable[[], None]:
    """Call ``listener`` with the name of each kernel that is about to be compiled, since it is not in the cache.

    What it raises ends the call that needs the kernel; those that were compiled before are kept. Return what takes it
    back.
    """
    registered = _Listener(listener)
    _events.register(_EVENT, registered)
    return lambda: _events.unregister(_EVENT, registered)


def announce_compiling(say: Callable[[str], object]) -> Callable[[], None]:
    """Have ``say`` called with a line for people when this process begins to compile; return what takes that back."""
    lines = iter([FIRST_START])
    return on_compiling(lambda _name: [say(line) for line in lines])


class _Listener(numba_event.Listener):
    def __init__(self, listener: Callable[[str], object]) -> None:
        self._listener = listener

    def on_start(self, event: Any) -> None:  # noqa: ANN401 - likewise
        function = event.data["dispatcher"].py_func
        self._listener(f"{function.__module__}.{function.__qualname__}")

    def on_end(self, event: object) -> None:
        """Do nothing: only the start is announced."""
