"""Brokers that may be killed, frozen and started again, each on a port that was free: Mosquitto and a nats-server."""

import os
import re
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path
from typing import Final

from demo.programs import HOST, DemoError, free_port

_PROGRAM_FOLDERS: Final = ("/usr/local/sbin", "/usr/sbin", "/sbin")
_START_S: Final = 60.0
_ALWAYS_SYNCS: Final = (2, 10)  # the first version whose JetStream can sync at every message, and that can refuse QoS 2
_OWN: Final = """
server_name: fleet
listen: 0.0.0.0:4222
max_payload: 262144
max_subscriptions: 100
jetstream {
  store_dir: /var/lib/nats
  sync_interval: always
  max_memory_store: 64MB
}
mqtt { listen: 0.0.0.0:8883 }
"""


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
            f"listener {self.port} {HOST}",
            "persistence true",
            f"persistence_location {folder}/",
            *(["autosave_interval 1", "autosave_on_changes true"] if is_durable else []),
            "max_inflight_messages 0",
            "max_queued_messages 0",
            "max_packet_size 262144",
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
        deadline_s = time.monotonic() + _START_S
        while True:
            with socket.socket() as probe:
                if probe.connect_ex((HOST, self.port)) == 0:
                    return
            if self._process.poll() is not None or time.monotonic() > deadline_s:
                raise DemoError((self._folder / "mosquitto.log").read_text(encoding="utf-8", errors="replace"))
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
            raise DemoError("the broker was not started")
        return self._process

    def _end(self, number: signal.Signals) -> None:
        if self._process is None:
            return
        self._process.send_signal(signal.SIGCONT)
        self._process.send_signal(number)
        self._process.wait(timeout=_START_S)
        self._process = None


class NatsServer:
    """One server; off until started.

    Parameters
    ----------
    folder : Path
        For configuration, data and log.
    text : str
        A configuration; its places for data, clients and vehicles are replaced by our own.
    """

    def __init__(self, folder: Path, text: str = _OWN) -> None:
        self.port, self.nats_port = free_port(), free_port()
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        self._program = shutil.which("nats-server", path=f"{os.environ.get('PATH', os.defpath)}:/usr/sbin")
        if self._program is None:
            raise DemoError("nats-server is not installed (Debian package nats-server)")
        for theirs, ours in (
            ("0.0.0.0:4222", f"127.0.0.1:{self.nats_port}"),
            ("0.0.0.0:8883", f"127.0.0.1:{self.port}"),
            ("/var/lib/nats", str(folder)),
        ):
            text = text.replace(theirs, ours)
        if version(self._program) < _ALWAYS_SYNCS:
            text = re.sub(r"\n *(sync_interval: always|reject_qos2_publish: true)", "", text)
        self._config = folder / "nats.conf"
        self._config.write_text(text, encoding="utf-8")

    @property
    def url(self) -> str:
        """Where workers connect; ``port`` is that of vehicles."""
        return f"nats://127.0.0.1:{self.nats_port}"

    @property
    def pid(self) -> int:
        """Process id of the running server."""
        if self._process is None:
            raise DemoError("nats-server was not started")
        return self._process.pid

    def start(self) -> None:
        """Start the server and wait until it listens on both ports; raises DemoError."""
        with (self._folder / "nats.log").open("ab") as log:
            self._process = subprocess.Popen(
                [str(self._program), "-c", str(self._config)], stdout=log, stderr=subprocess.STDOUT
            )
        deadline_s = time.monotonic() + _START_S
        while not all(_listens(port) for port in (self.port, self.nats_port)):
            if self._process.poll() is not None or time.monotonic() > deadline_s:
                raise DemoError("nats-server does not listen")
            time.sleep(0.02)

    def kill(self) -> None:
        """End the server as a power cut of its process would."""
        self._end(signal.SIGKILL)

    def stop(self) -> None:
        """End the server in order; it may be off."""
        self._end(signal.SIGTERM)

    def _end(self, number: signal.Signals) -> None:
        if self._process is not None:
            self._process.send_signal(number)
            self._process.wait()
            self._process = None


def version(program: str) -> tuple[int, ...]:
    """Return the version of a nats-server, such as (2, 9, 10); empty where it does not tell."""
    told = subprocess.run([program, "--version"], capture_output=True, text=True, check=False).stdout
    found = re.search(r"v(\d+)\.(\d+)\.(\d+)", told)
    return tuple(int(part) for part in found.groups()) if found else ()


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((HOST, port)) == 0


def _program(name: str) -> str:
    path = os.pathsep.join((os.environ.get("PATH", os.defpath), *_PROGRAM_FOLDERS))
    program = shutil.which(name, path=path)
    if program is None:
        raise DemoError(f"{name} is not installed (Debian package mosquitto)")
    return program
