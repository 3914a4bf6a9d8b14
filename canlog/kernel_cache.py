"""Where the machine code of kernels is kept: by what it was made of, for all checkouts and installations of a user.

numba's own key is the file that a kernel is written in. A law that is edited in another file would go on in its old
form in the kernels that call it, an edited comment compiles a whole file again, and each copy of the project compiles
for itself. Here the key is what goes into the machine code (`kernel_digest`).
"""

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any

from numba.core import config as numba_config
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache

from canlog.kernel_digest import kernel_key

NumbaObject = Any  # its modules have no types
STEP = 20  # kernels between two lines for people
KEPT_VERSIONS = 8  # of each kernel: as many checkouts can take turns without compiling
_config: NumbaObject = numba_config  # numba sets its members at run time
_listeners: list[Callable[[str], None]] = []
_names: list[str] = []


def on_compiling(listener: Callable[[str], None]) -> None:
    """Call ``listener`` with the name of each kernel that is about to be compiled, since it is not in the cache."""
    _listeners.append(listener)


def kernel_count() -> int:
    """Return how many kernels the modules have that were imported until now."""
    return len(_names)


def has_cache() -> bool:
    """Return whether machine code outlives this process."""
    return cache_folder(_config.CACHE_DIR) is not None


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


def announce_compiling(say: Callable[[str], object]) -> None:
    """Have ``say`` called with a line for people when this process begins to compile, and with more as it goes on."""
    count = 0

    def tell(_name: str) -> None:
        nonlocal count
        if count == 0:
            say(f"compiling numerical kernels, {_how_often()}; this takes up to a minute")
        elif count % STEP == 0:
            say(f"compiling numerical kernels: {count} done, at most {kernel_count()} to do in all")
        count += 1

    on_compiling(tell)


def _how_often() -> str:
    if has_cache():
        return "as at every first start"
    return "as at every start, since no folder can be written for them (NUMBA_CACHE_DIR names one)"


class _Locator:
    """Tells numba where the machine code of one kernel is, as its own locators do for files."""

    def __init__(self, function: NumbaObject, folder: Path) -> None:
        self._py_file = function.__code__.co_filename  # numba reads it for its warnings
        self._folder = folder
        self._key = kernel_key(function)

    @classmethod
    def from_function(cls, function: NumbaObject, _file: str) -> "_Locator | None":
        folder = cache_folder(_config.CACHE_DIR)
        return None if folder is None else cls(function, folder)

    def ensure_cache_path(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return self._key

    def get_disambiguator(self) -> str:
        return self._key


class _Implementation(CompileResultCacheImpl):
    def __init__(self, function: NumbaObject) -> None:
        self._locator_classes = [_Locator]
        super().__init__(function)  # type: ignore[no-untyped-call]


class _KernelCache(FunctionCache):
    _impl_class = _Implementation


class LateCache:
    """The cache of one kernel, which looks at it when it is first called: only then all that it uses is there.

    The methods are those that numba asks of a cache.
    """

    def __init__(self, dispatcher: NumbaObject) -> None:
        self._function = dispatcher.py_func
        self._name = f"{self._function.__module__}.{self._function.__qualname__}"
        _names.append(self._name)

    @cached_property
    def _cache(self) -> NumbaObject:
        try:
            return _KernelCache(self._function)  # type: ignore[no-untyped-call]
        except RuntimeError:  # no folder: machine code lives as long as the process
            return NullCache()

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever else numba asks of a cache
        return getattr(self._cache, name)

    def load_overload(self, signature: NumbaObject, target_context: NumbaObject) -> NumbaObject:
        """Return the machine code for some argument types, None if it must be compiled."""
        found = self._found(signature, target_context)
        if found is None:
            for listener in _listeners:
                listener(self._name)
        return found

    def _found(self, signature: NumbaObject, target_context: NumbaObject) -> NumbaObject:
        try:
            return self._cache.load_overload(signature, target_context)
        except Exception:  # noqa: BLE001 - damaged, or of an installation whose modules are no longer there
            self._cache.flush()
            return None

    def save_overload(self, signature: NumbaObject, data: NumbaObject) -> None:
        """Keep machine code; a full disk or a cache that was sealed meanwhile only costs the next start."""
        with suppress(OSError):
            self._cache.save_overload(signature, data)
            if self._cache.cache_path is not None:
                self._forget_old_versions()

    def _forget_old_versions(self) -> None:
        """Delete the machine code of this kernel's older forms beyond those that are kept."""
        stem = f"{self._function.__module__.rpartition('.')[2]}.{self._function.__qualname__}-"
        python = f".py{sys.version_info[0]}{sys.version_info[1]}"
        stem = stem.replace("<", "").replace(">", "")
        indices = [path for path in Path(self._cache.cache_path).glob(f"{stem}*.nbi") if python in path.name]
        indices.sort(key=lambda path: path.stat().st_mtime_ns, reverse=True)
        for index in indices[KEPT_VERSIONS:]:
            for path in (*index.parent.glob(f"{index.stem}.*.nbc"), index):
                path.unlink(missing_ok=True)
