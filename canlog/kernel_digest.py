"""What the machine code of a kernel is made of, as one short text: the key under which it is kept."""

import types
from collections.abc import Iterable, Iterator, Mapping
from enum import Enum
from hashlib import sha256
from typing import Any, NewType, TypeGuard

import numpy as np

KEY_CHARACTERS = 20  # of a sha256 in hexadecimal: 80 bits
OPTIONS = "compiled_with"  # attribute of a kernel's function that holds what the compiler was told
PLAIN_KINDS = (bool, int, float, complex, str, bytes, Enum, np.generic, np.dtype, type(None), type(Ellipsis))


class UnknownIngredientError(TypeError):
    """A kernel uses something whose value cannot be told apart from another one of its kind."""


def kernel_key(function: types.FunctionType) -> str:
    """Return a text that changes with the code of a kernel, of whatever it calls, and with every constant in them.

    Comments, docstrings, places of lines and other functions of the same files change nothing; a kernel that moves to
    another module changes, since what is kept of it names its module. To be asked when the
    kernel is first called: only then all names that it uses have a value.

    Raises
    ------
    UnknownIngredientError
        If a global name of the kernel stands for something of no known kind.
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
