"""Servers of our own, each on a port that was free: Mosquitto for a while, and PostgreSQL."""

import os
import pwd
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from demo.programs import HOST, OWN_GROUP, DemoError, free_port, last_line

_PROGRAM_FOLDERS: Final = ("/usr/local/sbin", "/usr/sbin", "/sbin")
ROLE: Final = "clutchdiag"
_DEBIAN_FOLDER: Final = Path("/usr/lib/postgresql")
_START_S: Final = 120.0
_STOP_S: Final = 120.0
_UNPRIVILEGED: Final = ("postgres", "nobody")


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
    port = free_port()
    config = folder / "mosquitto.conf"
    own = [f"listener {port} {HOST}", "allow_anonymous true", "max_packet_size 262144"]
    own += ["user root"] if os.getuid() == 0 else []
    config.write_text("\n".join([*own, *lines]) + "\n", encoding="utf-8")
    with (folder / "mosquitto.log").open("wb") as log:
        process = subprocess.Popen(
            [program, "-c", str(config)], stdout=log, stderr=subprocess.STDOUT, process_group=OWN_GROUP
        )
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
            if probe.connect_ex((HOST, port)) == 0:
                return
        if process.poll() is not None or time.monotonic() > deadline_s:
            raise DemoError("mosquitto does not listen")
        time.sleep(0.02)


class PostgresServer:
    """One server; off until started, its data survive a kill.

    Parameters
    ----------
    settings : sequence of str
        Server parameters as ``name=value``.
    kept : Path, optional
        A folder whose data outlive the server and are taken up again; by default a temporary one.
    """

    def __init__(self, settings: Sequence[str] = (), kept: Path | None = None) -> None:
        self.port = free_port()
        self._programs = program_folder()
        if self._programs is None:
            raise DemoError("PostgreSQL is not installed (Debian package postgresql)")
        self._settings = settings
        self._owner = _owner()
        self._is_kept = kept is not None
        self.folder = Path(tempfile.mkdtemp(prefix="clutchdiag-postgres-")) if kept is None else kept.resolve()
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._log = self.folder / "server.log"
        self._process: subprocess.Popen[bytes] | None = None
        if self._owner is not None:
            os.chown(self.folder, self._owner, -1)
        data = self.folder / "data"
        if not (data / "PG_VERSION").exists():
            self._run("initdb", "--pgdata", str(data), "-U", ROLE, "-A", "trust", "-E", "UTF8", "--no-sync")

    @property
    def pid(self) -> int:
        """Process id of the running server."""
        if self._process is None:
            raise DemoError("the database server was not started")
        return self._process.pid

    def url(self, database: str = "postgres") -> str:
        return f"postgresql+psycopg://{ROLE}@{HOST}:{self.port}/{database}"

    def start(self) -> None:
        """Start the server and wait until it answers."""
        settings = (f"port={self.port}", f"listen_addresses={HOST}", "unix_socket_directories=", *self._settings)
        options = [part for setting in settings for part in ("-c", setting)]
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                [self._program("postgres"), "-D", str(self.folder / "data"), *options],
                stdout=log,
                stderr=subprocess.STDOUT,
                cwd="/",
                user=self._owner,
                process_group=OWN_GROUP,
            )
        deadline_s = time.monotonic() + _START_S
        while self._answer("pg_isready", "-q", "-h", HOST, "-p", str(self.port)) != 0:
            if self._process.poll() is not None or time.monotonic() > deadline_s:
                raise DemoError(f"PostgreSQL does not start: {last_line(self._log)}")
            time.sleep(0.05)

    def create(self, database: str, template: str = "template1") -> str:
        """Create a database as a copy of a template, by default an empty one, and return its address."""
        where = ("-h", HOST, "-p", str(self.port), "-U", ROLE)
        self._run("createdb", *where, "--template", template, database)
        return self.url(database)

    def kill(self) -> None:
        """End the server as a power cut would."""
        self._end(signal.SIGKILL)

    def stop(self) -> None:
        """End the server at once but in order; it may be off."""
        self._end(signal.SIGINT)

    def close(self) -> None:
        """End the server and forget its data, unless they are kept."""
        self._end(signal.SIGINT if self._is_kept else signal.SIGQUIT)
        if self._is_kept:
            return
        shutil.rmtree(self.folder, ignore_errors=True)

    def _end(self, number: signal.Signals) -> None:
        if self._process is None:
            return
        self._process.send_signal(number)
        self._process.wait(_STOP_S)
        self._process = None

    def _run(self, program: str, *arguments: str) -> None:
        """Run one of the server's programs as the server's owner; its failure is ours."""
        done = subprocess.run(
            [self._program(program), *arguments], capture_output=True, text=True, check=False, cwd="/", user=self._owner
        )
        if done.returncode != 0:
            raise DemoError(f"{program} failed: {' '.join(done.stderr.split())}")

    def _answer(self, program: str, *arguments: str) -> int:
        return subprocess.run([self._program(program), *arguments], check=False, cwd="/").returncode

    def _program(self, name: str) -> str:
        return str((self._programs or Path()) / name)


def program_folder() -> Path | None:
    """Return where the newest installed server's programs are, or None without one."""
    found = [path.parent for path in _DEBIAN_FOLDER.glob("*/bin/postgres")]
    on_path = shutil.which("postgres")
    if found:
        return max(found, key=lambda folder: float(folder.parent.name))
    return None if on_path is None else Path(on_path).parent


def _owner() -> int | None:
    """Return the user id the server runs under where we are root, whom it refuses; else None, ourselves."""
    if os.getuid() != 0:
        return None
    for name in _UNPRIVILEGED:
        try:
            return pwd.getpwnam(name).pw_uid
        except KeyError:
            continue
    raise DemoError("PostgreSQL refuses to run as root, and there is no user 'postgres' or 'nobody'")
