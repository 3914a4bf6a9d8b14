"""The process that forks a child with limits for each MF4 file; see ``mf4``."""

import json
import os
import resource
import signal
import socket
import sys
from contextlib import suppress
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path

from canlog.errors import SourceError
from canlog.extras import wait_with
from canlog.logs.log_counts import LogCounts
from canlog.logs.mf4_frames import mf4_batches

LONGEST_REQUEST = 65_536
PAGE_BYTES = resource.getpagesize()
OUT_OF_MEMORY = "reading it takes more memory than any intact file of its size: it is damaged"


def serve(control: socket.socket) -> None:
    """Fork a child for every request, until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C is the parent's matter
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # children need no funeral
    wait_with("polars")  # which asammdf takes along, and reads no frame with
    with suppress(ImportError):
        import_module("asammdf")  # once, not in every child
    while True:
        request, descriptors, _, _ = socket.recv_fds(control, LONGEST_REQUEST, 1)
        if not request:
            return
        if os.fork() == 0:
            with suppress(OSError):  # nobody listens any more
                work(json.loads(request), Connection(descriptors[0], readable=False))
            os._exit(0)
        os.close(descriptors[0])


def work(request: dict[str, str | int], sending: Connection) -> None:
    """Do what a request says, within its limits, and send what comes of it."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * PAGE_BYTES + int(request["memory_bytes"]),) * 2)
    resource.setrlimit(resource.RLIMIT_CPU, (int(request["cpu_s"]),) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(request["file_bytes"]),) * 2)  # of copies that it makes
    counts = LogCounts()
    try:
        for batch in mf4_batches(Path(str(request["path"])), Path(str(request["folder"])), counts):
            sending.send(batch)
        sending.send(counts)
    except SourceError as exc:
        sending.send(str(exc))
    except MemoryError:
        sending.send(OUT_OF_MEMORY)


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])))
