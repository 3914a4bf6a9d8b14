"""ASAM MDF 4 files, read by asammdf in a child process: nobody vouches for a file, so memory and time are limited.

A child of the server (canlog/mf4_server.py) sends batches, then its counts; what ends it early is one clear error here.
"""

import json
import os
from collections.abc import Iterator
from contextlib import closing, suppress
from importlib.machinery import PathFinder
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

from canlog.errors import SourceError
from canlog.extras import extra_missing
from canlog.frames import FrameBatch
from canlog.logs.log_counts import LogCounts
from canlog.logs.mf4_blocks import UNFINISHED_MAGIC
from canlog.logs.mf4_channels import measured_channels
from canlog.logs.mf4_frames import NEEDS_ASAMMDF, mf4_batches
from canlog.mf4_server import IS_LIMITED, SERVER

MEMORY_BYTES = 128 * 1024 * 1024  # beyond what the library itself takes, for a small file
MEMORY_PER_BYTE = 4
COPY_PER_BYTE = 32  # of copies on the disk: records that were packed are there as they are
CPU_S = 2.0
BYTES_PER_CPU_S = 2_000_000
MEASURED_SLOWER = 4  # a byte, where records of many channels are packed
WAIT_PER_CPU_S = 20.0  # others may use the machine, too; processor time is what is limited
GAVE_UP = "reading it takes more time or memory than any intact file of its size: it is damaged"


def read_mf4(stream: BinaryIO, counts: LogCounts) -> Iterator[FrameBatch]:
    """Yield the frames of an MDF 4 file, as `mf4_frames.mf4_batches` does in the child.

    Raises SourceError if asammdf is not installed, or the file is damaged, not of version 4, or takes more time or
    memory than any sound file of its size does.
    """
    if PathFinder.find_spec("asammdf") is None:  # whether or not this process keeps itself from importing it
        raise extra_missing(NEEDS_ASAMMDF, "mf4")
    counts.unfinished = stream.read(len(UNFINISHED_MAGIC)) == UNFINISHED_MAGIC
    path = Path(stream.name)
    size_bytes = path.stat().st_size
    content_bytes = stored_bytes(path, size_bytes)
    with path.open("rb") as file:
        slower = MEASURED_SLOWER if measured_channels(file).groups else 1
    cpu_s = CPU_S + slower * content_bytes / BYTES_PER_CPU_S
    with TemporaryDirectory(prefix="clutchdiag-") as folder:
        if not IS_LIMITED:
            yield from mf4_batches(path, Path(folder), counts)
            return
        receiving, sending = Pipe(duplex=False)
        with closing(receiving):
            with closing(sending):
                request = {
                    "path": str(path.resolve()),
                    "folder": folder,
                    "memory_bytes": MEMORY_BYTES + MEMORY_PER_BYTE * content_bytes,
                    "file_bytes": MEMORY_BYTES + COPY_PER_BYTE * content_bytes,
                    "cpu_s": int(cpu_s) + 1,
                }
                SERVER.ask(json.dumps(request).encode(), sending.fileno())
            while isinstance(message := _receive(receiving, WAIT_PER_CPU_S * cpu_s), FrameBatch):
                yield message
    if isinstance(message, LogCounts):
        counts.add(message)
    elif path.stat().st_size < size_bytes:  # what ends a process that looks where the file no longer is
        counts.cut_off("where the file shrank while it was read")
    else:
        is_hollow = content_bytes < size_bytes / 2
        raise SourceError(f"{message}; most of the file was never written" if is_hollow else message)


def stored_bytes(path: Path, size_bytes: int) -> int:
    """Return how much of a file is there: what was never written takes no room, and holds nothing."""
    if not hasattr(os, "SEEK_DATA"):
        return size_bytes
    found_bytes, position = 0, 0
    with suppress(OSError), path.open("rb") as file:  # ENXIO: nothing more
        while position < size_bytes and found_bytes < size_bytes:
            start = os.lseek(file.fileno(), position, os.SEEK_DATA)
            position = os.lseek(file.fileno(), start, os.SEEK_HOLE)
            found_bytes += position - start
    return found_bytes


def _receive(receiving: Connection, wait_s: float) -> FrameBatch | LogCounts | str:
    """Return the next message of the child, or what is to be said of its end."""
    try:
        if receiving.poll(wait_s):
            message: FrameBatch | LogCounts | str = receiving.recv()
            return message
    except (EOFError, OSError):
        pass
    return GAVE_UP
