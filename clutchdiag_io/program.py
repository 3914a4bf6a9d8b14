"""What all programs share: threads, standard output, errors in one line."""

import hashlib
import io
import os
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

_THREAD_VARIABLES: Final = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
EXIT_UNEXPECTED: Final = 1
Kinds = type[Exception] | tuple[type[Exception], ...]


def reckon_in_one_thread() -> None:
    """Let numpy compute in one thread, in this process and its children, unless the environment says otherwise.

    Its matrices are so small here that threads only wait for each other. It is of use only before numpy is imported.
    On a machine with many cores, or with several processes at work, threads take processor time and gain none; and
    sums that they share differ in their last bit from one machine to the next.
    """
    for name in _THREAD_VARIABLES:
        os.environ.setdefault(name, "1")


@contextmanager
def standard_output() -> Iterator[None]:
    """Flush standard output at the end of the block, or raise OSError; a reader that hung up is no error.

    What the encoding does not have, a part of a file's name perhaps, is written as an escape.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        yield
        _write_out()
    except BrokenPipeError:
        discard()
    except OSError:
        with suppress(OSError):
            _write_out()
        raise


def discard() -> None:
    """Discard what standard output still buffers: the interpreter would report the broken pipe when it ends."""
    with suppress(OSError, ValueError, AttributeError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _write_out() -> None:
    try:
        if sys.stdout is not None:  # as it is where it was closed from outside
            sys.stdout.flush()
    except OSError:
        discard()
        raise


def complain(
    program: str, exc: Exception, statuses: Sequence[tuple[Kinds, int]], *, is_verbose: bool = False, hint: str = ""
) -> int:
    """Write one line about an error, if asked for also where it came from, and return the exit status.

    Parameters
    ----------
    statuses :
        The errors that may be expected, each with its status; the first that fits holds.
    hint :
        How the user learns more of an unexpected error.
    """
    status = next((code for kinds, code in statuses if isinstance(exc, kinds)), EXIT_UNEXPECTED)
    text = legible(" ".join(str(exc).split()))
    if status == EXIT_UNEXPECTED:
        text = f"unexpected {type(exc).__name__}: {text}{'' if is_verbose else hint}"
    if is_verbose:
        import traceback  # noqa: PLC0415 - needed here only

        traceback.print_exception(exc)
    sys.stderr.write(f"{program}: error: {text}\n")
    return status


def refusal(*paths: Path | None, is_forced: bool) -> str:
    """Return why these files must not be written; empty if they may be, as devices and pipes always may."""
    given = [path.absolute() for path in paths if path is not None]
    try:
        for path in given:
            if given.count(path) > 1 and (path.is_file() or not path.exists()):
                return f"two outputs cannot both be {path}"
        there = next((path for path in paths if path is not None and path.is_file() and not is_forced), None)
    except OSError as exc:
        return f"cannot write {exc.filename}: {exc.strerror}"
    return "" if there is None else f"{there} is there already; --force writes over it"


def replacement_refusal(path: Path, *, is_forced: bool) -> str:
    """Return why a new file must not take the place of this one; a device or a pipe would be gone for all others."""
    if complaint := refusal(path, is_forced=is_forced):
        return complaint
    return f"{path} is not a plain file and cannot be replaced" if path.exists() and not path.is_file() else ""


def legible(text: str) -> str:
    r"""Return a text with its undecodable bytes as escapes, such as ``log\xe9.log``."""
    try:
        return text.encode(errors="surrogateescape").decode(errors="backslashreplace")
    except UnicodeEncodeError:  # a lone surrogate that stands for no byte
        return text.encode(errors="backslashreplace").decode()


def legible_record(value: object) -> object:
    """Return a record of mappings and lists in which every text is legible."""
    if isinstance(value, str):
        return legible(value)
    if isinstance(value, Mapping):
        return {legible_record(key): legible_record(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [legible_record(item) for item in value]
    return value


def attached(group: str) -> dict[str, Any]:
    """Return what other distributions attach to a group by their entry points, by name."""
    return {entry.name: entry.load() for entry in sorted(entry_points(group=group), key=lambda entry: entry.name)}


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
            for path in sorted(Path(place, inner).rglob("*.py")):
                digest.update(path.read_bytes())
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
