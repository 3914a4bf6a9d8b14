"""Pytest plugin: a Mosquitto of our own on a free loopback port, which a test may kill, freeze and restart."""

import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.patience import HANG_S
from tests.support.ports import free_port

_PROGRAM_FOLDERS = ("/usr/local/sbin", "/usr/sbin", "/sbin")


class Mosquitto:
    """One broker with its own configuration and data; off until started. Its sessions survive a restart.

    Parameters
    ----------
    folder : Path
        For configuration, password file, data and log.
    lines : str
        More configuration, such as an access list.
    is_durable : bool
        Whether every change is saved at once, so that kill -9 forgets nothing; else Mosquitto's own default.
    users : dict, optional
        User names and passwords; without them everyone may connect.
    """

    def __init__(
        self,
        folder: Path,
        lines: tuple[str, ...] = (),
        users: dict[str, str] | None = None,
        *,
        is_durable: bool = True,
    ) -> None:
        self.port = free_port()
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        access = ["allow_anonymous true"]
        if users:
            passwords = folder / "passwords"
            passwords.touch(mode=0o600)
            for name, password in users.items():
                subprocess.run([_program("mosquitto_passwd"), "-b", str(passwords), name, password], check=True)
            access = ["allow_anonymous false", f"password_file {passwords}"]
        self._config = folder / "mosquitto.conf"
        text = [
            f"listener {self.port} 127.0.0.1",
            "persistence true",
            f"persistence_location {folder}/",
            *(["autosave_interval 1", "autosave_on_changes true"] if is_durable else []),
            "max_inflight_messages 0",
            "max_queued_messages 0",
            *(["user root"] if os.getuid() == 0 else []),
            *access,
            *lines,
        ]
        self._config.write_text("\n".join(text) + "\n", encoding="utf-8")

    @property
    def url(self) -> str:
        """Where the broker listens."""
        return f"mqtt://127.0.0.1:{self.port}"

    @property
    def pid(self) -> int:
        """Process id of the running broker."""
        return self._running().pid

    def start(self) -> None:
        """Start the broker and wait until it listens."""
        with (self._folder / "mosquitto.log").open("ab") as log:
            self._process = subprocess.Popen(
                [_program("mosquitto"), "-c", str(self._config)], stdout=log, stderr=subprocess.STDOUT
            )
        deadline_s = time.monotonic() + HANG_S
        while True:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            if self._process.poll() is not None or time.monotonic() > deadline_s:
                raise RuntimeError((self._folder / "mosquitto.log").read_text(encoding="utf-8", errors="replace"))
            time.sleep(0.02)

    def stop(self) -> None:
        """End the broker as its host would; it may be off."""
        self._end(signal.SIGTERM)

    def kill(self) -> None:
        """End the broker as a power cut would."""
        self._end(signal.SIGKILL)

    def forget(self) -> None:
        """Lose all sessions and messages, as a broker does that is killed before it saved them; it must be off."""
        (self._folder / "mosquitto.db").unlink(missing_ok=True)

    def freeze(self) -> None:
        """Let the broker go silent while its connections stay open."""
        self._running().send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let a frozen broker go on."""
        self._running().send_signal(signal.SIGCONT)

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            raise RuntimeError("the broker was not started")
        return self._process

    def _end(self, number: signal.Signals) -> None:
        if self._process is None:
            return
        self._process.send_signal(signal.SIGCONT)
        self._process.send_signal(number)
        self._process.wait(timeout=HANG_S)
        self._process = None


@pytest.fixture
def idle_broker(tmp_path: Path) -> Iterator[Mosquitto]:
    """Return a broker that has not been started."""
    folder = tmp_path / "mosquitto"
    folder.mkdir()
    broker = Mosquitto(folder)
    yield broker
    broker.stop()


@pytest.fixture
def broker(idle_broker: Mosquitto) -> Mosquitto:
    """Return a running broker that lets everyone in."""
    idle_broker.start()
    return idle_broker


def _program(name: str) -> str:
    path = os.pathsep.join((os.environ.get("PATH", os.defpath), *_PROGRAM_FOLDERS))
    program = shutil.which(name, path=path)
    if program is None:
        raise RuntimeError(f"{name} is not installed (Debian package mosquitto)")
    return program
