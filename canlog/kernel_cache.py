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
from numba.core.caching import IndexDataCacheFile
from numba.core.compiler import CompileResult
from numba.core.runtime import nrt

from canlog.kernel_digest import kernel_key

NumbaObject = Any  # its modules have no types
STEP = 20  # kernels between two lines for people
KEPT_VERSIONS = 8  # of each kernel: as many checkouts can take turns without compiling
_PYTHON = f".py{sys.version_info[0]}{sys.version_info[1]}"
_config: NumbaObject = numba_config  # numba sets its members at run time
_runtime: NumbaObject = nrt.rtsys
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

    on_compiling(tell)
    return lambda: _listeners.remove(tell)


def _how_often() -> str:
    if has_cache():
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
        _names.append(self._name)

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
        """Forget the machine code."""
        self._file.flush()

    def _forget_old_versions(self, folder: Path) -> None:
        """Delete the machine code of this kernel's older forms beyond those that are kept."""
        indices = sorted(folder.glob(f"{self._stem}*{_PYTHON}.nbi"), key=lambda path: -path.stat().st_mtime_ns)
        for index in indices[KEPT_VERSIONS:]:
            for path in (*folder.glob(f"{index.stem}.*.nbc"), index):
                path.unlink(missing_ok=True)
