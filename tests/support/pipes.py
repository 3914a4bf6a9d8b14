"""Standard input as a pipe into which a thread writes, with pauses where a test wants them; what is no plain file."""

import os
import socket
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support.patience import HANG_S

Step = bytes | Callable[[], object]  # what is written, or what is done or waited for in between


def a_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))


NO_PLAIN_FILES: Mapping[str, Callable[[Path], None]] = {
    "pipe": os.mkfifo,
    "directory": Path.mkdir,
    "socket": a_socket,
    "device": lambda path: path.symlink_to("/dev/zero"),
}


@contextmanager
def piped(monkeypatch: pytest.MonkeyPatch, steps: Iterable[Step]) -> Iterator[None]:
    """Let standard input be a pipe that gives these pieces one after the other, then its end."""
    reading, writing = os.pipe()

    def write() -> None:
        with os.fdopen(writing, "wb", buffering=0) as pipe:
            for step in steps:
                if callable(step):
                    step()
                else:
                    pipe.write(step)

    writer = threading.Thread(target=write, daemon=True)
    with os.fdopen(reading) as stream, monkeypatch.context() as patch:
        patch.setattr("sys.stdin", stream)
        writer.start()
        yield
        writer.join(HANG_S)


def pieces_of(content: bytes, sizes: Iterable[int]) -> Iterator[bytes]:
    """Yield some bytes in pieces of these sizes, the last with all that is left."""
    start = 0
    for size in sizes:
        yield content[start : start + size]
        start += size
    yield content[start:]
