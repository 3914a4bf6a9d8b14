"""The one way this project compiles a numerical kernel, and where its machine code is kept."""

import os
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
from numba.core import config as numba_config

P = ParamSpec("P")
R = TypeVar("R")
_config: Any = numba_config  # numba sets its members at run time


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


def _compiled(function: Callable[P, R], **options: bool) -> Callable[P, R]:
    configured = _config.CACHE_DIR
    _config.CACHE_DIR = cache_folder(_package_of(function), configured)
    try:
        return cast("Callable[P, R]", numba.njit(cache=True, nogil=True, **options)(function))  # type: ignore[call-overload]
    finally:
        _config.CACHE_DIR = configured


@cache
def cache_folder(package: Path, configured: str = "") -> str:
    """Return the folder for the machine code of a package's kernels, named after the sources they are made of.

    numba looks only at the file of a kernel, not at the kernels that it calls in other files: with one folder for all
    time, an edited law would go on in its old form. ``configured`` is numba's own setting of the parent folder; without
    it that is the user's cache. Where no folder can be made, the answer is empty: numba then decides.
    """
    digest = sha256()
    for source in sorted({*package.rglob("*.py"), *Path(__file__).parent.rglob("*.py")}):
        digest.update(source.read_bytes())
    parent = Path(configured or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "clutchdiag")
    folder = parent / f"{package.name}-{digest.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return ""
    return str(folder) if os.access(folder, os.W_OK) else ""


def _package_of(function: Callable[P, R]) -> Path:
    """Return the folder of the top-level package that a function was written in."""
    folder = Path(function.__code__.co_filename).parent
    while (folder.parent / "__init__.py").exists():
        folder = folder.parent
    return folder
