"""Controllers behind an ELM327 adapter (TCP or serial port) or a DoIP node.

Requests and answers are copied to a virtual bus of this process, where the diagnosis reads them as on any bus.
"""

import logging
import os
import select
import socket
import termios
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol
from urllib.parse import urlsplit

import can

from canlog.errors import NOTICE
from canlog.isotp import segments
from diag_service.errors import ConfigError, ControllerError, PendingError, RefusedError, SilentError, StoppedError
from diag_service.mapping.profile import AskingRules
from workshop.tester.addresses import CanAddress, hexadecimal, is_extended
from workshop.tester.answers import (
    MOST_PENDING_S,
    NEGATIVE,
    PENDING,
    PENDING_S,
    POSITIVE,
    OpenRequests,
    TesterTiming,
    is_data_answer,
    is_pending,
)
from workshop.tester.asking import LARGEST_LOGICAL, dialogue_over_ip, parse_doip

if TYPE_CHECKING:
    from workshop.tester.dialogue import Dialogue

ELM327, DOIP = "elm327", "doip"
ELM_PORT: Final = 35000
ELM_TOGETHER: Final = 3  # identifiers in a single frame, the longest request of the adapter
CONNECT_S: Final = 5.0
RESET_S: Final = 3.0  # after ATZ
ANSWER_S: Final = 1.0  # the adapter reports NO DATA earlier
LOOK_S: Final = 0.1
TRIED_S: Final = 1.5  # at each rate of a serial port
SPEEDS: Final = {38_400: termios.B38400, 115_200: termios.B115200, 9_600: termios.B9600}  # of ELM327, STN and clones
NOTHING: Final = b"\0"  # the data sheet of the ELM327: such characters are to be ignored
_INPUT_SPEED, _OUTPUT_SPEED = 4, 5  # of the attributes of a terminal
_PROTOCOL_11: Final = "ATSP6"
_SETTINGS: Final = ("ATE0", "ATL0", "ATS0", "ATH0", "ATAL", "ATCAF1", _PROTOCOL_11)  # no echo, no blanks, 500 kbit/s
_PROTOCOL_29: Final = "ATSP7"
_PROMPT: Final = b">"
_NEXT: Final = "is it plugged in, switched on and paired, and is that its port?"
_NO_ANSWER: Final = ("NODATA", "?", "STOPPED", "SEARCHING", "BUS", "CANERROR", "UNABLE", "BUFFER", "DATAERROR", "ERR")
_LOG: Final = logging.getLogger(__name__)


class Line(Protocol):
    """Access to controllers."""

    def ask(self, request: bytes, address: CanAddress) -> bytes | None:
        """Return the answer to a request; raises ControllerError.

        "Response pending" (78) if nothing else follows it in time; None: there is no answer.
        """


class ElmLine:
    """Controllers behind an ELM327 or compatible adapter (STN).

    Raises ControllerError if the adapter is missing or silent.
    """

    def __init__(self, place: str, stack: ExitStack, goes_on: Callable[[], bool]) -> None:
        self._goes_on = goes_on
        self._place = place
        try:
            port = _open_port(place, stack)
        except (OSError, termios.error) as exc:
            why = getattr(exc, "strerror", None) or exc.args[-1]
            raise ControllerError(f"adapter {place}: {why}: {_NEXT}") from exc
        self._descriptor = port.descriptor
        self._address: CanAddress | None = None
        self._waiting: dict[CanAddress, OpenRequests] = {}
        self._protocol = _SETTINGS[-1]
        self._is_prompted = True  # whether it waits for a command
        self._until_s = 0.0  # end of its time to answer
        if port.rates_baud:
            self._set_rate(port.rates_baud)
        self._command("ATZ", RESET_S)
        for setting in _SETTINGS:
            self._command(setting)

    def select(self, address: CanAddress) -> None:
        """Wait for the end of the last answer and set the next controller; raises ControllerError, StoppedError."""
        self._finish()
        if address == self._address:
            return
        if (protocol := _PROTOCOL_29 if is_extended(address.request_id) else _PROTOCOL_11) != self._protocol:
            self._command(protocol)
            self._protocol = protocol
        if is_extended(address.request_id):
            self._command(f"ATCP{address.request_id >> 24:02X}")
        self._command(f"ATSH{address.request_id & 0xFFFFFF:0{6 if is_extended(address.request_id) else 3}X}")
        self._command(f"ATCRA{address.response_id:X}")
        self._address = address

    def ask(self, request: bytes, address: CanAddress) -> bytes | None:
        """Return the answer to a request before the prompt, which comes after a timeout for further answers.

        What is returned without one is as `Line` says. Raises ControllerError, StoppedError.
        """
        self.select(address)
        text, waiting = request.hex().upper(), self._waiting.setdefault(address, OpenRequests(is_data_answer))
        self._begin(text, ANSWER_S)
        waiting.begin(request, time.monotonic())
        most_s, count = time.monotonic() + MOST_PENDING_S, 0
        other: bytes | None = None
        pending: bytes | None = None
        for output in self._read_outputs():
            messages = messages_in(output.removeprefix(text))  # some adapters echo in spite of ATE0
            for answer in messages[count:]:
                if is_pending(request, answer):
                    pending, self._until_s = answer, min(time.monotonic() + PENDING_S, most_s)
                elif (answered := waiting.answered_by(answer)) == request:
                    return answer
                elif answered is None and answer[0] == request[0] + POSITIVE:
                    other = answer
            count = len(messages)
        return other or pending

    def _set_rate(self, rates_baud: Sequence[int]) -> None:
        """Set the first rate at which the adapter is understood, and tell it; raises ControllerError, StoppedError."""
        for rate_baud in rates_baud:
            _set_speed(self._descriptor, rate_baud)
            if self._is_understood():
                _LOG.log(NOTICE, "adapter %s: %d baud", self._place, rate_baud)
                return
        *others, last = map(str, rates_baud)
        raise ControllerError(f"adapter {self._place} does not answer at {', '.join(others)} or {last} baud: {_NEXT}")

    def _is_understood(self) -> bool:
        """Return whether the adapter says what it is in characters that it can have sent."""
        self._begin("ATI", TRIED_S)
        try:
            *_, output = self._read_outputs()
        except SilentError:
            return False
        return output.isascii()

    def _command(self, text: str, wait_s: float = ANSWER_S) -> None:
        self._begin(text, wait_s)
        self._finish()

    def _begin(self, text: str, wait_s: float) -> None:
        try:
            while select.select([self._descriptor], [], [], 0.0)[0] and os.read(self._descriptor, 4096):
                pass  # earlier output
            os.write(self._descriptor, text.encode() + b"\r")
        except OSError as exc:
            raise ControllerError(f"adapter {self._place}: {exc.strerror or exc}") from exc
        self._is_prompted, self._until_s = False, time.monotonic() + wait_s

    def _finish(self) -> None:
        for _ in self._read_outputs():
            pass

    def _read_outputs(self) -> Iterator[str]:
        """Yield all lines since the command, whenever one more is complete, up to the prompt."""
        received = b""
        while not self._is_prompted:
            if not self._goes_on():
                raise StoppedError("stopped early")
            try:
                if not select.select([self._descriptor], [], [], LOOK_S)[0]:
                    if time.monotonic() > self._until_s:
                        raise SilentError(f"adapter {self._place} does not answer: {_NEXT}")
                    continue
                piece = os.read(self._descriptor, 4096)
            except OSError as exc:
                raise ControllerError(f"adapter {self._place}: {exc.strerror or exc}") from exc
            if not piece:
                raise ControllerError(f"adapter {self._place} has hung up")
            received += piece.replace(NOTHING, b"")
            self._is_prompted = _PROMPT in received
            lines, end, _ = received.rpartition(_PROMPT if self._is_prompted else b"\r")
            if end:
                yield lines.decode("ascii", "replace").strip("\r\n ")


def messages_in(text: str) -> list[bytes]:
    """Return the messages in the output of an ELM327: a line each, or a length and numbered lines."""
    messages, long, length = list[bytes](), b"", 0
    for line in text.replace("\n", "\r").split("\r"):
        words = line.strip().replace(" ", "").upper()
        if not words or words.startswith(_NO_ANSWER):
            continue
        _, colon, rest = words.rpartition(":")
        try:
            if colon:
                long += bytes.fromhex(rest)
                if len(long) >= length > 0:
                    messages.append(long[:length])
                    long, length = b"", 0
            elif len(words) == 3:
                long, length = b"", int(words, 16)
            else:
                messages.append(bytes.fromhex(words))
        except ValueError:
            continue
    return messages


@dataclass(frozen=True, slots=True, kw_only=True)
class Port:
    """An open way to an adapter."""

    descriptor: int
    rates_baud: tuple[int, ...] = ()  # of a serial port, to be tried in this order


def _open_port(place: str, stack: ExitStack) -> Port:
    """Return a TCP connection or a serial port; raises OSError, termios.error."""
    if place.startswith("/"):
        descriptor = os.open(place, os.O_RDWR | os.O_NOCTTY)
        stack.callback(os.close, descriptor)
        tty.setraw(descriptor)
        return Port(descriptor=descriptor, rates_baud=tuple(SPEEDS))
    host, _, port = place.rpartition(":")
    connection = socket.create_connection((host.strip("[]"), int(port)), timeout=CONNECT_S)
    stack.callback(connection.close)
    connection.setblocking(True)
    return Port(descriptor=connection.fileno())


def _set_speed(descriptor: int, rate_baud: int) -> None:
    settings = termios.tcgetattr(descriptor)
    settings[_INPUT_SPEED] = settings[_OUTPUT_SPEED] = SPEEDS[rate_baud]
    termios.tcsetattr(descriptor, termios.TCSANOW, settings)


class DoipLine:
    """A controller over IP."""

    def __init__(self, tester: "Dialogue") -> None:
        self._tester = tester

    def select(self, address: CanAddress) -> None:
        """Do nothing: the node is the controller."""

    def ask(self, request: bytes, address: CanAddress) -> bytes | None:
        """Return the answer to a request as `Line` says; raises ControllerError, StoppedError."""
        del address  # the node is the controller
        try:
            return self._tester.ask(request)
        except RefusedError as exc:
            return bytes([NEGATIVE, request[0], exc.code])
        except PendingError:
            return bytes([NEGATIVE, request[0], PENDING])
        except SilentError:
            return None


class MirroredLine:
    """Copies requests and answers to a bus."""

    def __init__(self, line: ElmLine | DoipLine, bus: can.BusABC) -> None:
        self._line = line
        self._bus = bus

    def ask(self, request: bytes, address: CanAddress) -> bytes | None:
        """Ask, and send request and answer on the bus; raises ControllerError, StoppedError."""
        self._line.select(address)
        self._mirror(request, address.request_id)
        answer = self._line.ask(request, address)
        if answer is not None:
            self._mirror(answer, address.response_id)
        return answer

    def _mirror(self, payload: bytes, can_id: int) -> None:
        for frame in segments(payload):
            self._bus.send(can.Message(arbitration_id=can_id, is_extended_id=is_extended(can_id), data=frame))


def parse_adapter(text: str) -> tuple[str, str, int]:
    """Return kind and place of an adapter, and the logical address of a node.

    ``elm327://HOST[:PORT]``, ``elm327:/dev/rfcomm0`` or ``doip://HOST[:PORT]/1011``; raises ConfigError.
    """
    parts = urlsplit(text)
    if parts.scheme == ELM327 and not parts.netloc and parts.path.startswith("/dev/"):
        return ELM327, parts.path, 0
    try:
        port = parts.port
    except ValueError:
        port = -1
    if port != -1 and parts.hostname:
        host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
        if parts.scheme == ELM327 and not parts.path.strip("/"):
            return ELM327, f"{host}:{port or ELM_PORT}", 0
        if parts.scheme == DOIP and parts.path.strip("/"):
            logical = hexadecimal(parts.path.strip("/"), "--adapter: the logical address", LARGEST_LOGICAL)
            return DOIP, host if port is None else f"{host}:{port}", logical
    raise ConfigError(
        f"--adapter must be elm327://HOST[:PORT], elm327:/dev/NAME or doip://HOST[:PORT]/1011, got {text!r}"
    )


def rules_through(adapter: str, rules: AskingRules) -> AskingRules:
    """Return the rules through an adapter: an ELM327 sends single frames only."""
    if parse_adapter(adapter)[0] != ELM327:
        return rules
    return AskingRules(together=min(rules.together, ELM_TOGETHER))


@contextmanager
def line_through(adapter: str, channel: str, goes_on: Callable[[], bool] = lambda: True) -> Iterator[MirroredLine]:
    """Open an adapter, copied to a virtual bus of this process.

    Raises ConfigError, ControllerError.
    """
    kind, place, logical = parse_adapter(adapter)
    with ExitStack() as stack:
        bus = stack.enter_context(can.Bus(channel, "virtual"))
        if kind == ELM327:
            yield MirroredLine(ElmLine(place, stack, goes_on), bus)
        else:
            tester = stack.enter_context(dialogue_over_ip(parse_doip(place, logical), TesterTiming(), goes_on=goes_on))
            yield MirroredLine(DoipLine(tester), bus)
