"""A cluster of Dask on this machine, with certificates of its own."""

import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Self

import psutil

from tests.support.certificates import certify, tls_words
from tests.support.patience import HANG_S
from tests.support.ports import free_port
from tests.support.service import NOTHING, environment

_POLL_S = 0.02


class Cluster:
    """A scheduler and workers, each to be started, killed and started again; all end with the block.

    Parameters
    ----------
    folder : Path
        For certificates and what the programs say.
    variables : Mapping of str to str
        More of their environment.
    preload : str
        A module that workers import first.
    """

    def __init__(self, folder: Path, variables: Mapping[str, str] = NOTHING, preload: str = "") -> None:
        self.tls = tls_words(certify(folder / "certificates", "node1"), "node1")
        self.port = free_port()
        self.address = f"tls://127.0.0.1:{self.port}"
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.workers: subprocess.Popen[bytes] | None = None
        self._folder = folder
        self._variables = {**environment(), **variables}
        self._preload = ("--preload", preload) if preload else ()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill(self.workers)
        self.kill(self.scheduler)

    def start_scheduler(self) -> None:
        """Start the scheduler and wait until it listens."""
        self.scheduler = self._started("scheduler", "--port", str(self.port))
        deadline_s = time.monotonic() + HANG_S
        while True:
            try:
                socket.create_connection(("127.0.0.1", self.port)).close()
            except OSError:
                if time.monotonic() > deadline_s or self.scheduler.poll() is not None:
                    raise
                time.sleep(_POLL_S)
            else:
                return

    def start_workers(self, *words: str) -> None:
        """Start the guardian of some workers."""
        self.workers = self._started("worker", self.address, "--nthreads", "1", *self._preload, *words)

    @staticmethod
    def kill(process: subprocess.Popen[bytes] | None) -> None:
        """Kill a program with all that it started."""
        if process is None:
            return
        try:
            family = [*psutil.Process(process.pid).children(recursive=True), psutil.Process(process.pid)]
        except psutil.NoSuchProcess:
            family = []
        for one in family:
            try:
                one.kill()
            except psutil.NoSuchProcess:
                continue
        process.wait(HANG_S)

    def listeners(self) -> set[str]:
        """Return the addresses at which the programs listen."""
        programs = [psutil.Process(one.pid) for one in (self.scheduler, self.workers) if one is not None]
        family = [member for one in programs for member in (one, *one.children(recursive=True))]
        return {
            link.laddr.ip for one in family for link in one.net_connections("inet") if link.status == psutil.CONN_LISTEN
        }

    def _started(self, part: str, *words: str) -> subprocess.Popen[bytes]:
        with (self._folder / f"{part}.txt").open("ab") as said:
            authority, certificate, key = self.tls[1::2]
            tls = ("--tls-ca-file", authority, "--tls-cert", certificate, "--tls-key", key)
            where = ("--host", "127.0.0.1", "--protocol", "tls", "--dashboard-address", "127.0.0.1:0")
            command = [sys.executable, "-m", "dask", part, *where, *words, *tls]
            return subprocess.Popen(command, stdout=said, stderr=said, env=self._variables)
