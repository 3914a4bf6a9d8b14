"""Faults asked for at run time: a Unix socket that takes one JSON object per line, with the keys of a scenario's table.

``{"kind": "loss", "share": 0.2, "duration_s": 5}`` breaks the bus, ``{"quantity": "engine_torque_nm", ...}`` a sensor.
Every line is answered by one: ``ok``, or ``error: `` and the reason. Only the user who runs the emulator may connect.
"""

import json
import os
import socket
import stat
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

from ecu_emulator.errors import ConfigError, RecordError
from ecu_emulator.scenario.faults import BusFault, SensorFault
from ecu_emulator.scenario.scenario_file import parse_fault

LINE_BYTES: Final = 4096
POLL_S: Final = 0.2  # how soon the end of the drive is noticed
IDLE_S: Final = 30.0  # a caller who says nothing makes room for the next one
OWNER_ONLY: Final = 0o177  # umask

Take = Callable[[SensorFault | BusFault], None]


class ControlSocket:
    """Listens while the ``with`` block runs, in a thread of its own.

    Parameters
    ----------
    path
        Where the socket shall be; one that a dead process left there is replaced.
    take
        Is handed every fault, in that thread; what it raises as ConfigError is the caller's answer.

    Raises
    ------
    RecordError
        If the socket cannot be made, or another process listens there.
    """

    def __init__(self, path: Path, take: Take) -> None:
        self._path = path
        self._take = take
        self._stop = threading.Event()
        self._socket = _listening(path)
        self._thread = threading.Thread(target=self._serve, name="control", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()
        with suppress(OSError):
            self._path.unlink()

    def _serve(self) -> None:
        while not self._stop.is_set():
            try:
                caller, _ = self._socket.accept()
            except TimeoutError:
                continue
            with caller, suppress(OSError):  # a caller that goes away is no concern of the drive
                caller.settimeout(POLL_S)
                self._converse(caller)

    def _converse(self, caller: socket.socket) -> None:
        pending, silent_s = b"", 0.0
        while not self._stop.is_set() and silent_s < IDLE_S:
            try:
                received = caller.recv(LINE_BYTES)
            except TimeoutError:
                silent_s += POLL_S
                continue
            *lines, pending = (pending + received).split(b"\n")
            for line in lines:
                caller.sendall(f"{self._answer(line)}\n".encode())
            if len(pending) > LINE_BYTES:
                caller.sendall(f"error: a line has at most {LINE_BYTES} bytes\n".encode())
                return
            if not received:
                return
            silent_s = 0.0

    def _answer(self, line: bytes) -> str:
        try:
            self._take(parse_fault(json.loads(line)))
        except (ValueError, RecursionError) as exc:
            return f"error: not JSON: {' '.join(str(exc).split())}"
        except ConfigError as exc:
            return f"error: {' '.join(str(exc).split())}"
        return "ok"


def _listening(path: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    before = os.umask(OWNER_ONLY)
    try:
        _remove_dead(path)
        listener.bind(str(path))
        listener.listen(1)
        listener.settimeout(POLL_S)
    except OSError as exc:
        listener.close()
        raise RecordError(f"cannot listen at {path}: {exc.strerror or exc}") from exc
    except RecordError:
        listener.close()
        raise
    finally:
        os.umask(before)
    return listener


def _remove_dead(path: Path) -> None:
    with suppress(FileNotFoundError):
        if not stat.S_ISSOCK(path.lstat().st_mode):
            raise RecordError(f"cannot listen at {path}: there is a file")
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
            try:
                caller.connect(str(path))
            except ConnectionRefusedError:
                path.unlink()
            else:
                raise RecordError(f"cannot listen at {path}: another process listens there already")
