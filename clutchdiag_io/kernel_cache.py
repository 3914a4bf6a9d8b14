"""Where numba keeps the machine code of kernels."""

import hashlib
import os
import shutil
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Final

PACKAGES: Final = ("canlog", "clutch_model", "diag_service/diagnosis", "diag_service/mapping", "ecu_emulator")
KEPT_FOLDERS: Final = 4  # as many versions of the sources can take turns without compiling


def choose_kernel_cache() -> None:
    """Have numba keep machine code in a folder of these sources, in the user's cache or where NUMBA_CACHE_DIR says.

    numba compiles a kernel again when its own file changes. An edited law in another file would live on in the kernels
    that call it, so each state of the sources has a folder (NUMBA_CACHE_DIR); the oldest ones are deleted.
    """
    digest = hashlib.sha256()
    for package in PACKAGES:
        top, _, inner = package.partition("/")
        spec = find_spec(top)
        for place in (spec and spec.submodule_search_locations) or ():
            for folder, folders, names in os.walk(Path(place, inner)):
                folders.sort()
                for name in sorted(names):
                    if name.endswith(".py"):
                        digest.update(Path(folder, name).read_bytes())
    cache = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    parent = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(cache, "clutchdiag"))
    if parent.name == digest.hexdigest():  # chosen by the program that started this one
        return
    chosen = parent / digest.hexdigest()
    os.environ["NUMBA_CACHE_DIR"] = str(chosen)
    with suppress(OSError):  # numba takes another folder then
        chosen.mkdir(parents=True, exist_ok=True)
        os.utime(chosen)
        versions = [path for path in parent.iterdir() if len(path.name) == len(chosen.name)]
        for path in sorted(versions, key=lambda path: path.stat().st_mtime)[:-KEPT_FOLDERS]:
            shutil.rmtree(path, ignore_errors=True)
