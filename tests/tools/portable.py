"""What analysts do with recordings, on whatever system this runs: ``python -m tests.tools.portable [LOG]``.

``--without-posix`` takes away what only POSIX has, and ends with an error if anything of it is missed.
"""

import argparse
import importlib.abc
import os
import signal
import socket
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Final

ROOT: Final = Path(__file__).parents[2]
DBC: Final = ROOT / "dbc" / "dct.dbc"
LOG: Final = ROOT / "tests" / "golden" / "recordings" / "ideal.log.xz"
BLOCKED: Final = frozenset({"fcntl", "resource", "pwd", "grp", "termios", "tty", "pty"})
OF_OS: Final = ("fork", "forkpty", "getuid", "makedev", "O_NOCTTY", "O_CLOEXEC", "SEEK_DATA", "SEEK_HOLE")
OF_SIGNAL: Final = ("SIGUSR1", "SIGUSR2", "SIGHUP")
OF_SOCKET: Final = ("AF_CAN", "PF_CAN", "CAN_RAW", "AF_NETLINK", "CMSG_SPACE")


class _Blocker(importlib.abc.MetaPathFinder):
    def find_spec(  # as the import system calls it
        self,
        fullname: str,
        path: Sequence[str] | None,  # noqa: ARG002 - the import system's signature
        target: ModuleType | None = None,  # noqa: ARG002 - likewise
    ) -> ModuleSpec | None:
        if fullname in BLOCKED:
            raise ImportError(f"{fullname} is of POSIX")
        return None


def forget_posix() -> None:
    """Take away what only POSIX has."""
    for name in BLOCKED:
        sys.modules.pop(name, None)
    sys.meta_path.insert(0, _Blocker())
    for module, names in ((os, OF_OS), (signal, OF_SIGNAL), (socket, OF_SOCKET)):
        for name in names:
            if hasattr(module, name):
                delattr(module, name)


def use_recordings(log: Path, folder: Path) -> None:
    """Report, analyse, decode, inspect and survey a log by program and library; raises SystemExit if that fails."""
    from diag_service.cli import main  # noqa: PLC0415 - after what is taken away

    for words in (
        ["report", log, "-o", folder / "report.html"],
        ["analyze", log, "--store", folder / "car.sqlite", "-o", folder / "out.jsonl"],
        ["history", folder / "car.sqlite"],
        ["decode", log, "--dbc", DBC, "-o", folder / "out.csv"],
        ["inspect", log, "--json"],
        ["signals", log, "--dbc", DBC],
    ):
        if status := main([str(word) for word in words]):
            raise SystemExit(f"{words} ended with status {status}")
    import diag_service  # noqa: PLC0415 - likewise

    diag_service.inspect(log, DBC)
    diag_service.analyze(log, store=folder / "other.sqlite")
    count = len(diag_service.read(log).signals())
    print(f"{count} signals of {log.name} on {sys.platform}, Python {sys.version.split()[0]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", nargs="?", type=Path, default=LOG, metavar="LOG", help="default: a stored recording")
    parser.add_argument("--without-posix", action="store_true", help="as if this were no POSIX system")
    options = parser.parse_args()
    if options.without_posix:
        forget_posix()
    with TemporaryDirectory() as name:
        use_recordings(options.log, Path(name))
    if options.without_posix and (loaded := (BLOCKED | {"canlog.live"}) & set(sys.modules)):
        raise SystemExit(f"loaded all the same: {', '.join(sorted(loaded))}")


if __name__ == "__main__":
    main()
