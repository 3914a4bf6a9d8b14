"""The one way this project compiles a numerical kernel, and where the machine code of kernels is kept.

It is kept for all checkouts and installations of a user, by what it was made of (`kernel_key`). numba's own key is the
file that a kernel is written in: a law that is edited in another file would go on in its old form in the kernels that
call it, an edited comment compiles a whole file again, and each copy of the project compiles for itself.
"""

import os
import sys
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from enum import Enum
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any, NewType, ParamSpec, TypeGuard, TypeVar, cast

import numba
import numpy as np
from numba.core import config as numba_config
from numba.core import types as numba_types
from numba.core.caching import IndexDataCacheFile
from numba.core.compiler import CompileResult
from numba.core.runtime import nrt

NumbaObject = Any  # its modules have no types
STEP = 20  # kernels between two lines for people
KEPT_VERSIONS = 8  # of each kernel: as many checkouts can take turns without compiling
_PYTHON = f".py{sys.version_info[0]}{sys.version_info[1]}"
_config: NumbaObject = numba_config  # numba sets its members at run time
_runtime: NumbaObject = nrt.rtsys
_listeners: list[Callable[[str], None]] = []
KEY_CHARACTERS = 20  # of a sha256 in hexadecimal: 80 bits
OPTIONS = "compiled_with"  # attribute of a kernel's function that holds what the compiler was told
PLAIN_KINDS = (bool, int, float, complex, str, bytes, Enum, np.generic, np.dtype, type(None), type(Ellipsis))


class UnknownIngredientError(TypeError):
    """A kernel uses something whose value cannot be told apart from another one of its kind."""


def kernel_key(function: types.FunctionType) -> str:
    """Return a text that changes with the code of a kernel, of whatever it calls, and with every constant in them.

    Comments, docstrings, places of lines and other functions of the same files change nothing; a kernel that moves to
    another module changes, since what is kept of it names its module. To be asked when the kernel is first called: only
    then all names that it uses have a value. Raises UnknownIngredientError if a global name of the kernel stands for
    something of no known kind.
    """
    digest = sha256()
    for piece in _of_function(function, set()):
        digest.update(piece.encode(errors="backslashreplace"))
        digest.update(b"\0")
    return digest.hexdigest()[:KEY_CHARACTERS]


def _of_function(function: types.FunctionType, seen: set[int]) -> Iterator[str]:
    if id(function) in seen:
        return
    seen.add(id(function))
    names = set[str]()
    yield f"{function.__module__}.{function.__qualname__}"  # machine code that is kept refers to it
    yield from _of_code(function.__code__, function.__doc__, names)
    yield repr((function.__defaults__, vars(function).get(OPTIONS)))
    for cell in function.__closure__ or ():
        yield from _of_value(cell.cell_contents, names, seen)
    for name in sorted(names & function.__globals__.keys()):
        yield name
        yield from _of_value(function.__globals__[name], names, seen)
    for annotation in function.__annotations__.values():  # a record's fields are the layout of what is passed
        if _is_record(annotation):
            yield from _of_value(annotation, names, seen)


def _of_code(code: types.CodeType, docstring: str | None, names: set[str]) -> Iterator[str]:
    """Yield what a piece of bytecode does, and note the names that it uses."""
    names.update(code.co_names)
    yield code.co_code.hex()
    yield repr((code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars, code.co_flags))
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _of_code(constant, None, names)
        elif constant is None or constant != docstring:
            yield repr(constant)


def _of_value(value: object, names: set[str], seen: set[int]) -> Iterator[str]:
    """Yield what is compiled in of a global value."""
    inner = getattr(value, "py_func", value)
    if isinstance(inner, types.FunctionType) and not _is_foreign(inner.__module__):
        yield from _of_function(inner, seen)
    elif isinstance(value, types.ModuleType):
        if _is_foreign(value.__name__):
            yield value.__name__
        else:
            yield from _of_names(vars(value), names, seen)
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype.str} {value.shape}"
        yield sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
    elif isinstance(value, PLAIN_KINDS):
        yield repr(value)
    elif isinstance(value, tuple | list | frozenset):
        yield from _of_items(sorted(value, key=repr) if isinstance(value, frozenset) else value, names, seen)
    elif isinstance(value, type) and issubclass(value, Enum):
        yield repr(list(value))
    elif _is_record(value):
        fields: dict[str, Any] = value.__annotations__
        yield f"{value.__module__}.{value.__qualname__}"
        yield repr([(name, str(kind)) for name, kind in fields.items()])
        yield from _of_items([kind for kind in fields.values() if _is_record(kind)], names, seen)
    elif isinstance(value, type | types.BuiltinFunctionType | np.ufunc | types.GenericAlias | NewType) or _is_foreign(
        str(getattr(value, "__module__", "canlog"))
    ):
        yield str(getattr(value, "__qualname__", value))
    else:
        raise UnknownIngredientError(f"a kernel uses {value!r}, whose value has no digest")


def _of_names(table: Mapping[str, object], names: set[str], seen: set[int]) -> Iterator[str]:
    """Yield those attributes of one of our modules that the code may take: kernels reach them as ``module.name``."""
    for name in sorted(names & table.keys()):
        value = table[name]
        if not isinstance(value, types.ModuleType):
            yield name
            yield from _of_value(value, names, seen)


def _of_items(values: Iterable[object], names: set[str], seen: set[int]) -> Iterator[str]:
    for value in values:
        yield from _of_value(value, names, seen)


def _is_record(value: object) -> TypeGuard[type]:
    return isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields")


def _is_foreign(module: str) -> bool:
    """Return whether a module is a library's: what it holds changes with numba's or numpy's version only."""
    return module.partition(".")[0] in FOREIGN


FOREIGN = frozenset({"numpy", "numba", "math", "builtins", "typing", "cmath", "collections", "scipy"})


def on_compiling(listener: Callable[[str], None]) -> Callable[[], None]:
    """Call ``listener`` with the name of each kernel that is about to be compiled, since it is not in the cache.

    What it raises ends the call that needs the kernel; those that were compiled before are kept. Return what takes it
    back.
    """
    _listeners.append(listener)
    return lambda: _listeners.remove(listener)


def cache_folder(configured: str) -> Path | None:
    """Return where machine code is kept, None where that is nowhere.

    ``configured`` is numba's setting of the cache's folder (``NUMBA_CACHE_DIR``); without it that is the user's cache.
    """
    try:
        parent = Path(configured or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "clutchdiag")
        folder = parent / "kernels"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # no home, no rights, something else in the way
        return None
    return folder if os.access(folder, os.W_OK) else None


def announce_compiling(say: Callable[[str], object]) -> Callable[[], None]:
    """Have ``say`` called with a line for people when this process begins to compile, and with more as it goes on.

    Return what takes that back.
    """
    count = 0

    def tell(_name: str) -> None:
        nonlocal count
        if count == 0:
            say(f"compiling numerical kernels, {_how_often()}; this takes up to a minute")
        elif count % STEP == 0:
            say(f"compiling numerical kernels: {count} done, of those that this run needs")
        count += 1

    return on_compiling(tell)


def _how_often() -> str:
    if cache_folder(_config.CACHE_DIR) is not None:
        return "as at every first start"
    return "as at every start, since no folder can be written for them (NUMBA_CACHE_DIR names one)"


class LateCache:
    """Keeps the machine code of one kernel; looks at it when it is first called: only then all that it uses is there.

    The methods are those that numba asks of a cache.
    """

    def __init__(self, dispatcher: NumbaObject) -> None:
        self._function = dispatcher.py_func
        self._name = f"{self._function.__module__}.{self._function.__qualname__}"
        self._stem = f"{self._name.removeprefix(self._function.__module__.rpartition('.')[0] + '.')}-"

    @cached_property
    def cache_path(self) -> str | None:
        """Folder of the machine code; None where that lives as long as the process."""
        folder = cache_folder(_config.CACHE_DIR)
        return None if folder is None else str(folder)

    @cached_property
    def _file(self) -> NumbaObject:
        key = kernel_key(self._function)
        return IndexDataCacheFile(self.cache_path, f"{self._stem}{key}{_PYTHON}", key)  # type: ignore[no-untyped-call]

    def load_overload(self, signature: NumbaObject, target_context: NumbaObject) -> NumbaObject:
        """Return the machine code for some argument types, None if it must be compiled."""
        found = None if self.cache_path is None else self._found(signature, target_context)
        if found is None:
            for listener in _listeners:
                listener(self._name)
        return found

    def _found(self, signature: NumbaObject, target_context: NumbaObject) -> NumbaObject:
        try:
            _runtime.initialize(target_context)  # a whole refresh imports the compiler, a fifth of a program's start
            kept = self._file.load((signature, target_context.codegen().magic_tuple()))
            return None if kept is None else CompileResult._rebuild(target_context, *kept)  # type: ignore[no-untyped-call]  # noqa: SLF001 - as numba's own cache
        except Exception:  # noqa: BLE001 - damaged, or of an installation whose modules are no longer there
            self.flush()
            return None

    def save_overload(self, signature: NumbaObject, compiled: NumbaObject) -> None:
        """Keep machine code; a full disk or a cache that was sealed meanwhile only costs the next start."""
        if self.cache_path is None or compiled.library.has_dynamic_globals:
            return
        with suppress(OSError):
            Path(self.cache_path).mkdir(parents=True, exist_ok=True)
            key = signature, compiled.codegen.magic_tuple()
            self._file.save(key, compiled._reduce())  # noqa: SLF001 - as numba's own cache
            self._forget_old_versions(Path(self.cache_path))

    def flush(self) -> None:
        self._file.flush()

    def _forget_old_versions(self, folder: Path) -> None:
        """Delete the machine code of this kernel's older forms beyond those that are kept."""
        indices = sorted(folder.glob(f"{self._stem}*{_PYTHON}.nbi"), key=lambda path: -path.stat().st_mtime_ns)
        for index in indices[KEPT_VERSIONS:]:
            for path in (*folder.glob(f"{index.stem}.*.nbc"), index):
                path.unlink(missing_ok=True)


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
