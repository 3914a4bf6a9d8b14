"""Files that hold a secret: for their owner only, small, and perhaps a pipe that a command writes into."""

import errno
import os
import select
from io import FileIO
from pathlib import Path
from typing import Final

from canlog.files import read_small_file
from fleet_link.errors import AddressError

MAX_SECRET_BYTES: Final = 64 * 1024
PIPE_WAIT_S: Final = 5.0  # for whoever writes a secret into a pipe
_OTHERS: Final = 0o077  # permission bits of group and world


def check_secret_mode(path: Path) -> None:
    """Raise AddressError if a file that holds a secret is missing or open to others than its owner."""
    try:
        mode = path.stat().st_mode
    except OSError as exc:
        raise AddressError(f"cannot read {path}: {exc.strerror}") from exc
    if mode & _OTHERS:
        raise AddressError(f"{path} holds a secret and may be read by others: chmod 600 {path}")


def read_secret(path: Path, pipe_wait_s: float = PIPE_WAIT_S) -> str:
    """Return the secret in a file, without the end of its line; raises AddressError."""
    check_secret_mode(path)
    try:
        return _read_secret(path, pipe_wait_s).decode("utf-8").rstrip("\r\n")
    except OSError as exc:
        raise AddressError(f"cannot read {path}: {exc.strerror or exc}") from exc
    except UnicodeDecodeError as exc:
        raise AddressError(f"cannot read {path}: it is not UTF-8 text") from exc


def _read_secret(path: Path, pipe_wait_s: float) -> bytes:
    """Return what a file holds, or what a command writes into the pipe that a shell makes of ``<(command)``."""
    if not path.is_fifo():
        return read_small_file(path, MAX_SECRET_BYTES)
    content, poll = bytearray(), select.poll()
    with FileIO(str(path), opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
        poll.register(file, select.POLLIN)
        while len(content) <= MAX_SECRET_BYTES:
            if not poll.poll(pipe_wait_s * 1_000):
                raise OSError(errno.ETIMEDOUT, f"nobody has written into this pipe for {pipe_wait_s:g} s")
            piece = file.read(MAX_SECRET_BYTES)
            if not piece:
                return bytes(content)
            content += piece
    raise OSError(errno.EFBIG, "a secret cannot be so long")
