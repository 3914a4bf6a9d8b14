"""The first and last moments of a program: a signal ends it without a word."""

import gc
import hashlib
import os
import shutil
import signal
import sys
from collections.abc import Collection
from contextlib import suppress
from importlib import import_module
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
    # Each candidate that does not fit is described in colours otherwise: a twentieth of the time to compile.
    os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
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


# Objects made before it is looked for garbage among them: loading makes hundreds of thousands, and none of it is.
UNCOLLECTED: Final = 50_000
STATUS_STOPPED: Final = 0
STATUS_INTERRUPTED: Final = 130


def run_program(module: str, services: Collection[str] = ()) -> int:
    """Load the command line of a program, run its ``main`` and return the exit status.

    Parameters
    ----------
    services :
        First words of commands whose usual end is a signal: SIGINT and SIGTERM end them with 0, at once before and
        after they heed signals themselves.
    """
    is_service = not {*sys.argv[1:2]}.isdisjoint(services)
    status = STATUS_STOPPED if is_service else STATUS_INTERRUPTED
    numbers = (signal.SIGINT, signal.SIGTERM) if is_service else (signal.SIGINT,)
    before, *_ = [signal.signal(number, lambda *_: os._exit(status)) for number in numbers]
    gc.set_threshold(UNCOLLECTED)
    choose_kernel_cache()
    program = import_module(module)
    if not is_service:
        signal.signal(signal.SIGINT, before)
    from click import Abort  # noqa: PLC0415 - loading it takes a while, in which Ctrl-C must already be heeded

    try:
        return int(program.main())
    except (KeyboardInterrupt, Abort):
        return STATUS_INTERRUPTED
    finally:
        for number in numbers:  # a signal that comes while the interpreter winds down must not change the status
            signal.signal(number, signal.SIG_IGN)
        gc.freeze()  # or the interpreter looks through all there is, a fifth of the time of a short program
