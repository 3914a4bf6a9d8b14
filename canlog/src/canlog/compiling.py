"""How numba compiles kernels; loaded when the first one is called."""

import gc
from collections.abc import Callable
from typing import Any, Final

import numba
from numba.core import event
from numba.extending import register_jitable

from canlog.jit import listeners, parts

# No kernel makes an array: without the last option, which numba does not list, the use of each argument is counted.
_OPTIONS: Final[dict[str, Any]] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": False}


def compiled(function: Callable[..., Any]) -> Any:  # noqa: ANN401 - numba's dispatcher, untyped
    """Return a kernel as numba compiles it for the types of each call, once it knows all parts."""
    for part in list(parts):  # of two threads each sees to it that all are known
        register_jitable(**_OPTIONS, no_cpython_wrapper=True)(part)
        parts.pop(part, None)
    try:
        return numba.njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:  # no folder can be written
        return numba.njit(**_OPTIONS)(function)


class _Compiling(event.Listener):
    """Tells the listeners of each kernel, and collects no garbage meanwhile: that takes a tenth of the time."""

    def __init__(self) -> None:
        self._depth = 0  # parts are compiled inside a kernel
        self._was_enabled = False

    def on_start(self, start: Any) -> None:  # noqa: ANN401 - numba has no types
        if self._depth == 0:
            self._was_enabled = gc.isenabled()
            gc.disable()
        self._depth += 1
        function = start.data["dispatcher"].py_func
        for listener in list(listeners):
            listener(f"{function.__module__}.{function.__qualname__}")

    def on_end(self, end: object) -> None:  # noqa: ARG002 - numba's signature
        self._depth -= 1
        if self._depth == 0 and self._was_enabled:
            gc.enable()


_register: Callable[..., None] = event.register  # untyped
_register("numba:compile", _Compiling())
