"""A Mosquitto of our own: its configuration in a folder, its port free until then, its end with the block."""

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from demo.errors import DemoError

_PROGRAM_FOLDERS: Final = ("/usr/local/sbin", "/usr/sbin", "/sbin")
_START_S: Final = 60.0


@contextmanager
def mosquitto(folder: Path, lines: Sequence[str] = ()) -> Iterator[int]:
    """Run a broker for as long as the block lasts and yield its port; ``lines`` add to its configuration.

    Raises
    ------
    DemoError
        If it is not installed or does not listen.
    """
    path = os.pathsep.join((os.environ.get("PATH", os.defpath), *_PROGRAM_FOLDERS))
    program = shutil.which("mosquitto", path=path)
    if program is None:
        raise DemoError("mosquitto is not installed (Debian package mosquitto)")
    port = _free_port()
    config = folder / "mosquitto.conf"
    own = [f"listener {port} 127.0.0.1", "allow_anonymous true", *(["user root"] if os.getuid() == 0 else [])]
    config.write_text("\n".join([*own, *lines]) + "\n", encoding="utf-8")
    with (folder / "mosquitto.log").open("wb") as log:
        process = subprocess.Popen([program, "-c", str(config)], stdout=log, stderr=subprocess.STDOUT)
    try:
        _wait_until_it_listens(process, port)
        yield port
    finally:
        process.terminate()
        process.wait()


def _wait_until_it_listens(process: subprocess.Popen[bytes], port: int) -> None:
    deadline_s = time.monotonic() + _START_S
    while True:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        if process.poll() is not None or time.monotonic() > deadline_s:
            raise DemoError("mosquitto does not listen")
        time.sleep(0.02)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
