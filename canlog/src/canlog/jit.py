"""The one way this project marks a numerical kernel, and how those who wait for its compilation hear of it.

Nothing is compiled before a kernel is called, and until then numba is not loaded: that takes a second, and many
programs call no kernel.
"""

import sys
from collections.abc import Callable
from functools import update_wrapper
from typing import Any, Final, Generic, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
FIRST_START: Final = "first start: compiling, takes about 20 s"

parts: dict[Callable[..., Any], None] = {}  # that numba does not know yet
listeners: list[Callable[[str], object]] = []


class Kernel(Generic[P, R]):
    """A function that becomes machine code when it is first called, kept on disk and free of the interpreter lock.

    ``__call__`` is an attribute of each kernel, which Python calls without a step between: first what compiles, then
    what was compiled.
    """

    __slots__ = ("__call__", "__dict__")
    __call__: Callable[P, R]

    def __init__(self, function: Callable[P, R]) -> None:
        update_wrapper(self, function)
        self._function = function
        self._is_waiting = True
        self.__call__ = self._first

    def _first(self, *arguments: P.args, **named: P.kwargs) -> R:
        result: R = self.compiled(*arguments, **named)
        return result

    @property
    def compiled(self) -> Any:  # noqa: ANN401 - numba's dispatcher, untyped
        """The kernel as numba's own object, which compiles for the types of each call."""
        if self._is_waiting:
            from canlog.compiling import compiled  # noqa: PLC0415 - it loads numba

            self.__call__ = compiled(self._function)
            self._is_waiting = False
        return self.__call__

    @property
    def _numba_type_(self) -> Any:  # noqa: ANN401 - likewise
        """What numba asks a global of another kernel for."""
        return self.compiled._numba_type_


def is_numba_loaded() -> bool:
    """Return whether numba is loaded, so that a kernel costs no second of waiting for it."""
    return "numba" in sys.modules


def kernel(function: Callable[P, R]) -> Kernel[P, R]:
    """Have numba compile a function, by ``numba.njit`` with a cache, when it is first called."""
    return Kernel(function)


def part(function: Callable[P, R]) -> Callable[P, R]:
    """Let kernels call a function, which becomes machine code with them; Python runs it as it stands.

    It needs no entry for Python and no file of the cache, which cost a kernel a third of its time to compile.
    """
    parts[function] = None
    return function


def on_compiling(listener: Callable[[str], object]) -> Callable[[], None]:
    """Call ``listener`` with the name of each kernel that is about to be compiled, since it is not in the cache.

    What it raises ends the call that needs the kernel; those that were compiled before are kept. Return what takes it
    back.
    """
    listeners.append(listener)
    return lambda: listeners.remove(listener)


def announce_compiling(say: Callable[[str], object]) -> Callable[[], None]:
    """Have ``say`` called with a line for people when this process begins to compile; return what takes that back."""
    lines = iter([FIRST_START])
    return on_compiling(lambda _name: [say(line) for line in lines])
