"""The process that forks a child with limits for each MF4 file: it loads asammdf once, so a file costs milliseconds."""

import atexit
import os
import socket
import subprocess
import sys
import threading
from contextlib import closing, suppress
from typing import Final

from canlog.errors import SourceError

CHILD: Final = "canlog.logs.mf4_child"
IS_LIMITED: Final = sys.platform == "linux" and hasattr(os, "fork")  # elsewhere files are read in this process
SUFFIXES: Final = (".mf4", ".mdf")


class Mf4Server:
    """The process that forks the children; started when it is first needed, ended with this one."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._control: socket.socket | None = None

    def ask(self, request: bytes, reply_to: int) -> None:
        """Have a child do what the request says and write to this pipe.

        Raises SourceError if no process can be started.
        """
        with self._lock:
            try:
                socket.send_fds(self._running(), [request], [reply_to])
            except OSError as exc:
                raise SourceError(f"no process can be started to read it: {exc.strerror or exc}") from exc

    def start(self) -> None:
        """Start it before it is asked."""
        if IS_LIMITED:
            with self._lock, suppress(OSError):  # whoever asks is told
                self._running()

    def stop(self) -> None:
        """End it, also while it still loads; its children go on."""
        if self._control is not None and self._process is not None:
            self._control.close()
            self._process.terminate()
            self._process.wait()

    @property
    def is_started(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def _running(self) -> socket.socket:
        if self._control is None or not self.is_started:
            return self._start()
        return self._control

    def _start(self) -> socket.socket:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with closing(theirs):
            self._process = subprocess.Popen(  # noqa: S603 - this interpreter, a module of this package
                [sys.executable, "-m", CHILD, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                env={**os.environ, "PYTHONPATH": os.pathsep.join(folder for folder in sys.path if folder)},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        self._control = ours
        return ours


SERVER: Final = Mf4Server()
atexit.register(SERVER.stop)
