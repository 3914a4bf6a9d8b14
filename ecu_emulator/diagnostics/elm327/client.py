"""One client of the adapter's port: its lines, its prompt, and what takes its time, in a thread of its own."""

import queue
import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import can

from ecu_emulator.diagnostics.codes import NEGATIVE, Nrc
from ecu_emulator.diagnostics.elm327.interpreter import Interpreter, Shown
from ecu_emulator.diagnostics.elm327.interpreter import line as frame_line

MOST_LINE_BYTES: Final = 512
MOST_MONITORED: Final = 512  # frames that a client has not taken yet
STOPPED: Final = "STOPPED"
BUFFER_FULL: Final = "BUFFER FULL"
SEND_TIMEOUT_S: Final = 10.0  # a client that takes nothing for so long has gone
POLL_S: Final = 0.2
_READ_BYTES: Final = 4096
_IGNORED: Final = b"\0\n"


@dataclass(slots=True)
class ElmCounts:
    """What came and went."""

    clients: int = 0
    refused_clients: int = 0
    lines: int = 0
    overlong_lines: int = 0


class Client:
    """One connection and the adapter as it sees it."""

    def __init__(
        self,
        number: int,
        connection: socket.socket,
        interpreter: Interpreter,
        counts: ElmCounts,
        patience_s: float,
        idle_s: float,
        leave: Callable[["Client"], None],
    ) -> None:
        self.number = number  # by which the controller knows it
        self._connection = connection
        self._interpreter = interpreter
        self._counts = counts
        self._patience_s = patience_s
        self._idle_s = idle_s
        self._leave = leave
        self._heard = b""
        self._frames: queue.Queue[can.Message] = queue.Queue(MOST_MONITORED)
        self._responses: queue.Queue[bytes] = queue.Queue(MOST_MONITORED)
        self._monitors = threading.Event()
        self._waits = threading.Event()
        self._is_full = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ELM327 client", daemon=True)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def end(self) -> None:
        """Hang up, and wait until that is done."""
        with suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        self._thread.join()

    def hear_frame(self, message: can.Message) -> None:
        """Keep a frame for the client if it wants any."""
        if not self._monitors.is_set() or message.is_error_frame:
            return
        try:
            self._frames.put_nowait(message)
        except queue.Full:
            self._is_full.set()

    def hear_response(self, payload: bytes) -> None:
        """Keep a response for the client if it waits for one."""
        if self._waits.is_set():
            with suppress(queue.Full):
                self._responses.put_nowait(payload)

    def _run(self) -> None:
        try:
            with self._connection, suppress(OSError):  # whoever goes away is no concern of the drive
                self._connection.settimeout(SEND_TIMEOUT_S)
                self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._converse()
        finally:
            self._leave(self)

    def _converse(self) -> None:
        while (text := self._line()) is not None:
            self._counts.lines += 1
            if len(text) > MOST_LINE_BYTES:
                self._counts.overlong_lines += 1
                self._say([text[:MOST_LINE_BYTES]] if self._interpreter.settings.echoes else [])
                self._prompt(["?"])
                continue
            self._say([text] if self._interpreter.settings.echoes else [])
            self._waits.set()  # before the question: its answer may be there at once
            shown = self._interpreter.take(text)
            self._say(shown.lines)
            self._prompt(self._more(shown))

    def _more(self, shown: Shown) -> list[str]:
        """Return what there is to say before the prompt, after what takes its time."""
        try:
            if shown.monitors:
                return self._monitored()
            return [] if shown.awaited is None else self._awaited(shown.awaited)
        finally:
            self._waits.clear()
            _emptied(self._responses)

    def _line(self) -> str | None:
        """Return the next line, None at the end; of one that is too long no more than tells that it is."""
        while b"\r" not in self._heard:
            if not self._read():
                return None
            if b"\r" not in self._heard:
                self._heard = self._heard[: MOST_LINE_BYTES + 1]
        text, _, self._heard = self._heard.partition(b"\r")
        return text.decode("ascii", "replace").replace("\ufffd", "?")

    def _read(self) -> bool:
        """Return whether more has come; waits for it, but not for ever: a silent client makes room for others."""
        self._connection.settimeout(self._idle_s)
        received = self._connection.recv(_READ_BYTES)
        self._connection.settimeout(SEND_TIMEOUT_S)
        self._heard += received.translate(None, _IGNORED)
        return bool(received)

    def _is_interrupted(self, patience_s: float) -> bool:
        """Return whether the client says anything, which ends what the adapter does and means nothing else."""
        if not self._heard:
            if not select.select([self._connection], [], [], patience_s)[0]:
                return False
            if not self._read():
                raise ConnectionResetError
        self._heard = self._heard[1:]
        return True

    def _monitored(self) -> list[str]:
        _emptied(self._frames)
        self._is_full.clear()
        self._monitors.set()
        try:
            while not self._is_full.is_set():
                if self._is_interrupted(0.0):
                    return [STOPPED]
                with suppress(queue.Empty):
                    message = self._frames.get(timeout=POLL_S)
                    settings, data = self._interpreter.settings, bytes(message.data)
                    self._say([frame_line(message.arbitration_id, data, settings, len(data))])
            return [BUFFER_FULL]
        finally:
            self._monitors.clear()

    def _awaited(self, service: int) -> list[str]:
        """Say the response that was announced (78), when it comes."""
        until_s = time.monotonic() + self._patience_s
        while time.monotonic() < until_s:
            if self._is_interrupted(0.01):
                return [STOPPED]
            with suppress(queue.Empty):
                response = self._responses.get_nowait()
                if service not in {response[0] - 0x40, response[1] if response[0] == NEGATIVE else None}:
                    continue
                self._say(self._interpreter.lines(response))
                if response[0] != NEGATIVE or response[2] != Nrc.RESPONSE_PENDING:
                    return []
                until_s = time.monotonic() + self._patience_s
        return []

    def _say(self, lines: "list[str] | tuple[str, ...]") -> None:
        end = "\r\n" if self._interpreter.settings.has_line_feeds else "\r"
        self._connection.sendall("".join(f"{text}{end}" for text in lines).encode("ascii"))

    def _prompt(self, lines: list[str]) -> None:
        self._say([*lines, ""])
        self._connection.sendall(b">")


def _emptied(waiting: "queue.Queue[can.Message] | queue.Queue[bytes]") -> None:
    with suppress(queue.Empty):
        while True:
            waiting.get_nowait()
