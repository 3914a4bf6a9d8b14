"""Programs before a terminal of a stated width, into pipes, and into pipes that nobody reads."""

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from dataclasses import dataclass
from pathlib import Path
from typing import Final

RUN_S: Final = 300.0  # reached by what hangs only
_ESCAPES: Final = re.compile(rb"\x1b\[[0-9;?]*[A-Za-z]|\x1b\][^\x07]*\x07")


@dataclass(frozen=True, slots=True)
class Run:
    """What became of a program."""

    status: int
    out: bytes
    err: bytes

    @property
    def lines(self) -> list[str]:
        """Standard output without colours."""
        return _ESCAPES.sub(b"", self.out).decode().replace("\r\n", "\n").splitlines()


def in_terminal(width: int, module: str, *words: str | Path, cwd: Path | None = None) -> Run:
    """Run a program with standard output on a terminal so many columns wide."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 50, width, 0, 0))
    try:
        process = subprocess.Popen(
            [sys.executable, "-m", module, *words],
            stdin=subprocess.DEVNULL,
            stdout=theirs,
            stderr=subprocess.PIPE,
            env={**_environment(), "TERM": "xterm-256color"},
            cwd=cwd,
        )
    finally:
        os.close(theirs)
    pieces = []
    with process, os.fdopen(ours, "rb", buffering=0) as terminal:
        try:
            while piece := terminal.read(65536):
                pieces.append(piece)
        except OSError:  # Linux says so that the other end is closed
            pass
        assert process.stderr is not None
        err = process.stderr.read()
        status = process.wait(RUN_S)
    return Run(status, b"".join(pieces), err)


def in_broken_pipe(module: str, *words: str | Path, cwd: Path | None = None) -> Run:
    """Run a program whose standard output nobody reads any more."""
    reading, writing = os.pipe()
    os.close(reading)
    try:
        return _into(writing, module, *words, cwd=cwd)
    finally:
        os.close(writing)


def on_full_disk(module: str, *words: str | Path, cwd: Path | None = None) -> Run:
    """Run a program whose standard output is on a disk without room."""
    with Path("/dev/full").open("wb") as full:
        return _into(full.fileno(), module, *words, cwd=cwd)


def before_head(module: str, *words: str | Path, cwd: Path | None = None) -> Run:
    """Run ``program | head -1``; the status is the program's own."""
    reading, writing = os.pipe()
    try:
        with subprocess.Popen(["head", "-1"], stdin=reading, stdout=subprocess.PIPE) as head:
            os.close(reading)
            done = _into(writing, module, *words, cwd=cwd)
            assert head.stdout is not None
            return Run(done.status, head.stdout.read(), done.err)
    finally:
        os.close(writing)


def _into(descriptor: int, module: str, *words: str | Path, cwd: Path | None) -> Run:
    done = subprocess.run(
        [sys.executable, "-m", module, *words],
        stdout=descriptor,
        stderr=subprocess.PIPE,
        env=_environment(),
        cwd=cwd,
        timeout=RUN_S,
        check=False,
    )
    return Run(done.returncode, b"", done.stderr)


def _environment() -> dict[str, str]:
    """Return the environment without what would say how wide a terminal is, or that there is one."""
    unwanted = {"COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"}
    return {name: value for name, value in os.environ.items() if name not in unwanted}
