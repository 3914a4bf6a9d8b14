"""Requests to one controller by udsoncan, can-isotp and doipclient, with late answers, busy and silent controllers."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Final, Self

import can

from canlog.extras import extra_missing, load_extra
from diag_service.errors import (
    ControllerError,
    MalformedAnswerError,
    PendingError,
    RefusedError,
    SilentError,
    StoppedError,
)
from workshop.tester.addresses import CanAddress
from workshop.tester.answers import (
    BUSY,
    DEFAULT_SESSION,
    SECURITY,
    SESSION,
    STOPPED,
    DialogueCounts,
    OpenRequests,
    TesterTiming,
    belongs,
    fault,
    hex_text,
    is_pending,
    refusal_text,
    request_text,
)
from workshop.tester.listening import CLASSIC_BYTES, PADDING, receive, send

_client, _messages, _connectors = (
    load_extra(name, "DoIP needs doipclient", "uds", "./workshop")
    for name in ("doipclient", "doipclient.messages", "doipclient.connectors")
)
connector: Final = _connectors.DoIPClientUDSConnector
_PIECE_BYTES: Final = 65_536
_TCP: Final = _client.DoIPClient.TransportType.TRANSPORT_TCP
logging.getLogger("doipclient").setLevel(logging.CRITICAL + 1)  # it warns of every unexpected message


class DoipNode(_client.DoIPClient):  # type: ignore[misc, name-defined]  # a library without types
    """Waits for the given time; the library's class waits 2 s, and drops data that come after the timeout."""

    def read_doip(self, timeout: float = 2.0, transport: Any = _TCP) -> Any:  # noqa: ANN401 - messages without a common type
        """Return the next message, parts stay in the parser; raises OSError after the timeout [s] or at the end."""
        if transport != _TCP:
            return super().read_doip(timeout, transport)
        until_s, piece, usual_s = time.monotonic() + timeout, b"", self._tcp_sock.gettimeout()
        try:
            while True:
                message, piece = self._tcp_parser.read_message(bytearray(piece)), b""
                if isinstance(message, _messages.GenericDoIPNegativeAcknowledge):
                    raise ConnectionError(f"the node takes no such message: code {message.nack_code:02X}")
                if isinstance(message, _messages.AliveCheckRequest):
                    self.send_doip_message(_messages.AliveCheckResponse(self._client_logical_address))
                elif message is not None:
                    return message
                else:
                    left_s = until_s - time.monotonic()
                    if left_s <= 0.0:
                        raise TimeoutError("the node does not answer in time")
                    self._tcp_sock.settimeout(left_s)
                    piece = self._tcp_sock.recv(_PIECE_BYTES)
                    if not piece:
                        raise ConnectionResetError("the node has closed the connection")
        finally:
            self._tcp_sock.settimeout(usual_s)


try:
    import isotp
    from udsoncan.client import Client
    from udsoncan.configs import default_client_config
    from udsoncan.connections import BaseConnection
    from udsoncan.exceptions import (
        InvalidResponseException,
        NegativeResponseException,
        TimeoutException,
        UnexpectedResponseException,
    )
    from udsoncan.Request import Request

    from workshop.isotp_frames import isotp_address
except ImportError as exc:
    raise extra_missing("asking controllers needs udsoncan and can-isotp", "uds", "./workshop") from exc

__all__ = ["CanConnection", "Dialogue", "TimeoutException"]

LONGEST_MESSAGE: Final = 65_535
TIMEOUT_MS: Final = 1000  # N_Bs and N_Cr
MOST_WAIT_FRAMES: Final = 100  # flow controls "wait" in a row
FD_BYTES: Final = 64
MOST_OLD_FRAMES: Final = 10_000  # dropped before a request
LONGEST_RECEPTION_S: Final = 60.0  # of one message; its frames have timeouts of their own
PATIENCE_S: Final = 0.05
_BREAKS: Final = (isotp.errors.ConsecutiveFrameTimeoutError, isotp.errors.WrongSequenceNumberError)
_ISOTP_LOGGER: Final = "diag_service.isotp"  # the library warns of every invalid frame
logging.getLogger(_ISOTP_LOGGER).setLevel(logging.CRITICAL + 1)


class CanConnection(BaseConnection):
    """A connection of udsoncan over an open bus, which it does not close.

    Parameters
    ----------
    bus, address
        An open bus, and the controller on it.
    is_fd
        Whether requests go out in CAN FD frames.
    goes_on
        Called during a transfer; False ends it with StoppedError.
    """

    def __init__(
        self,
        bus: can.BusABC,
        address: CanAddress,
        *,
        is_fd: bool = False,
        goes_on: Callable[[], bool] = lambda: True,
    ) -> None:
        super().__init__("CAN")
        self._bus = bus
        self._address = address
        self._is_open = False
        self._next: isotp.CanMessage | None = None
        self._goes_on = goes_on
        self._is_sent_in_part = self._is_broken_off = False
        self._layer = isotp.TransportLayerLogic(
            rxfn=self._take_frame,
            txfn=self._send_frame,
            address=isotp_address(address.request_id, address.response_id, address.tester_byte, address.target_byte),
            error_handler=self._note_error,
            params={
                "stmin": 0,
                "blocksize": 0,
                "tx_padding": PADDING,
                "tx_data_min_length": CLASSIC_BYTES,
                "tx_data_length": FD_BYTES if is_fd else CLASSIC_BYTES,
                "can_fd": is_fd,
                "bitrate_switch": is_fd,
                "max_frame_size": LONGEST_MESSAGE,
                "rx_flowcontrol_timeout": TIMEOUT_MS,
                "rx_consecutive_frame_timeout": TIMEOUT_MS,
                "wftmax": MOST_WAIT_FRAMES,
                "logger_name": _ISOTP_LOGGER,
            },
        )

    def open(self) -> "CanConnection":
        self._is_open = True
        return self

    def close(self) -> None:
        """Close the connection, not the bus."""
        self._is_open = False

    def is_open(self) -> bool:
        return self._is_open

    def empty_rxqueue(self) -> None:
        """Drop frames from before a request."""
        for _ in range(MOST_OLD_FRAMES):
            if self._receive(0.0) is None:
                break
        self._layer.reset()

    def specific_send(self, payload: bytes, timeout: float | None = None) -> None:
        """Send a request.

        Raises SilentError without flow control in time, ControllerError if the bus refuses a frame.
        """
        del timeout  # the transport layer has its own
        self._is_sent_in_part = False
        self._layer.send(payload)
        self._layer.process()
        while self._layer.transmitting():
            self._process_next(PATIENCE_S)
        if self._is_sent_in_part:
            raise SilentError(f"{self._address} does not take the whole of the request {request_text(payload)}")

    def specific_wait_frame(self, timeout: float | None = None) -> bytes:
        """Return the next message, which must begin within the timeout.

        Raises
        ------
        TimeoutException
            If none begins in time.
        SilentError
            If one is broken off.
        ControllerError
            If the bus cannot be read.
        """
        self._is_broken_off = False
        begun_s = time.monotonic()
        until_s = begun_s + (LONGEST_RECEPTION_S if timeout is None else timeout)
        while (message := self._layer.recv()) is None:
            left_s = until_s - time.monotonic()
            if self._layer.is_rx_active():
                left_s = max(left_s, begun_s + LONGEST_RECEPTION_S - time.monotonic())
            if left_s <= 0.0:
                raise TimeoutException("no answer")  # type: ignore[no-untyped-call]  # the library has no annotation here
            self._process_next(min(PATIENCE_S, left_s))
            if self._is_broken_off:
                raise SilentError(f"{self._address} began an answer and broke it off")
        return bytes(message)

    def _process_next(self, patience_s: float) -> None:
        """Pass the next frame to the transport layer, and let it send what is due."""
        if not self._goes_on():
            raise StoppedError(STOPPED)
        due_s = self._layer.next_cf_delay()
        self._next = self._receive(patience_s if due_s is None else min(patience_s, due_s))
        self._layer.process()

    def _receive(self, patience_s: float) -> isotp.CanMessage | None:
        message = receive(self._bus, patience_s)
        if message is None or message.is_error_frame or message.is_remote_frame:
            return None
        return isotp.CanMessage(
            arbitration_id=message.arbitration_id,
            data=bytes(message.data),
            extended_id=message.is_extended_id,
            is_fd=message.is_fd,
        )

    def _take_frame(self, _timeout_s: float) -> isotp.CanMessage | None:
        message, self._next = self._next, None
        return message

    def _send_frame(self, frame: isotp.CanMessage) -> None:
        message = can.Message(
            arbitration_id=frame.arbitration_id,
            is_extended_id=frame.is_extended_id,
            is_fd=frame.is_fd,
            bitrate_switch=frame.bitrate_switch,
            data=frame.data,
        )
        send(self._bus, message)

    def _note_error(self, error: Exception) -> None:
        self._is_sent_in_part = True
        self._is_broken_off |= isinstance(error, _BREAKS)


LOOK_S: Final = 0.1  # period at which `goes_on` is called
_KEY: Final = 1  # added to the level that asked for the seed
_LOGGER: Final = "diag_service"  # prefixed by the library, which warns of every refusal
logging.getLogger(f"UdsClient[{_LOGGER}]").addHandler(logging.NullHandler())


class Dialogue:
    """Asks one controller, one request at a time.

    Parameters
    ----------
    connection
        To the controller; opened and closed by this object, which is a context manager.
    where
        The controller, for people.
    timing
        Timeouts and numbers of repetitions.
    goes_on
        Called while it waits; False ends that with StoppedError.
    """

    def __init__(
        self,
        connection: BaseConnection,
        where: str,
        timing: TesterTiming,
        *,
        goes_on: Callable[[], bool] = lambda: True,
    ) -> None:
        self.where = where
        self.timing = timing
        self.counts = DialogueCounts()
        self._goes_on = goes_on
        self._filter = _Matching(connection, self.counts, goes_on)
        self._pending = 0
        self._client = Client(self._filter, _client_config(self.timing, self._note_pending))
        self._last_s = float("-inf")

    def __enter__(self) -> Self:
        self._client.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()

    def ask(self, request: bytes) -> bytes:
        """Return the positive response to a request, empty if it was suppressed.

        A busy controller is asked again after growing pauses, a silent one once more.

        Raises
        ------
        RefusedError, SilentError
            If it refuses, or does not answer.
        MalformedAnswerError
            If its answer violates the standard.
        ControllerError
            If the connection is broken.
        """
        busy, silent, begun_s = 0, 0, time.monotonic()
        while True:
            try:
                return self._ask_once(request)
            except RefusedError as exc:
                busy += 1
                if exc.code != BUSY:
                    raise
                if busy > self.timing.most_busy:
                    asked = f"asked for {request_text(request)} {busy} times in {time.monotonic() - begun_s:.0f} s"
                    raise RefusedError(f"{self.where} is busy ({asked}): try again later", BUSY) from exc
                self.counts.busy += 1
                self._rest(self.timing.busy_pause_s * 2.0 ** (busy - 1))
            except PendingError:  # it has received the request
                raise
            except SilentError:
                silent += 1
                self.counts.silent += 1
                if silent >= self.timing.most_silent:
                    raise

    def _ask_once(self, request: bytes) -> bytes:
        gap_s = self._last_s + self.timing.gap_s - time.monotonic()
        if gap_s > 0.0:
            self._rest(gap_s)
        self.counts.requests += 1
        self._filter.begin(request)
        self._pending = 0
        begun_s = time.monotonic()
        try:
            response = self._client.send_request(Request.from_payload(request))
        except NegativeResponseException as exc:
            self._check(request, bytes(exc.response.original_payload or b""))
            self.counts.refusals += 1
            code = int(exc.response.code or 0)
            text = f"{self.where} refuses {request_text(request)}: {refusal_text(code)}"
            raise RefusedError(text, code) from exc
        except TimeoutException as exc:
            if self._pending:
                times = "once" if self._pending == 1 else f"{self._pending} times"
                text = (
                    f"{self.where} asked for more time {times} in {time.monotonic() - begun_s:.0f} s and never answered"
                )
                raise PendingError(f"{text} {request_text(request)}") from exc
            stray = self._filter.stray
            more = f": what came instead, last {hex_text(stray)}, does not answer it" if stray else ""
            raise SilentError(f"{self.where} does not answer {request_text(request)}{more}") from exc
        except (InvalidResponseException, UnexpectedResponseException, OSError, RuntimeError) as exc:
            raise ControllerError(f"{self.where}: {' '.join(str(exc).split())}") from exc
        finally:
            self._last_s = time.monotonic()
        if response is None:
            return b""
        return self._check(request, bytes(response.original_payload or b""))

    def _check(self, request: bytes, response: bytes) -> bytes:
        if wrong := fault(request, response):
            text = (
                f"{self.where} answers {request_text(request)} with {hex_text(response)}, which is not a valid answer"
            )
            raise MalformedAnswerError(f"{text}: {wrong}")
        return response

    def _note_pending(self) -> None:
        self._pending += 1

    def _rest(self, duration_s: float) -> None:
        until_s = time.monotonic() + duration_s
        while (left_s := until_s - time.monotonic()) > 0.0:
            if not self._goes_on():
                raise StoppedError(STOPPED)
            time.sleep(min(LOOK_S, left_s))

    def ask_or_refusal(self, request: bytes) -> bytes | RefusedError:
        """Return the positive response, or the refusal; raises as ``ask`` otherwise."""
        try:
            return self.ask(request)
        except RefusedError as exc:
            return exc

    @contextmanager
    def session(self, number: int) -> Iterator[None]:
        """Enter a session, and return to the default one at the end."""
        if number == DEFAULT_SESSION:
            yield
            return
        self.ask(bytes([SESSION, number]))
        try:
            yield
        finally:
            with suppress(ControllerError):  # it also ends after S3
                self.ask(bytes([SESSION, DEFAULT_SESSION]))

    @contextmanager
    def patience(self, longest_s: float) -> Iterator[None]:
        """Allow each request so much time [s] with response pending (78)."""
        self._client.set_config("request_timeout", max(longest_s, self.timing.p2_s))
        try:
            yield
        finally:
            self._client.set_config("request_timeout", max(self.timing.longest_s, self.timing.p2_s))

    def unlock(self, level: int, mask: bytes) -> None:
        """Unlock a security level whose key is its seed XOR a mask, unless it is unlocked already."""
        seed = self.ask(bytes([SECURITY, level]))[2:]
        if not any(seed):
            return
        if len(seed) != len(mask):
            raise ControllerError(f"{self.where} has a seed of {len(seed)} bytes, the mask has {len(mask)}")
        key = bytes(seed_byte ^ mask_byte for seed_byte, mask_byte in zip(seed, mask, strict=True))
        self.ask(bytes([SECURITY, level + _KEY]) + key)


def _client_config(timing: TesterTiming, on_pending: Callable[[], None]) -> Any:  # noqa: ANN401 - a typed dictionary of the library, of which this is a part
    return {
        **default_client_config,
        "request_timeout": max(timing.longest_s, timing.p2_s),
        "p2_timeout": timing.p2_s,
        "p2_star_timeout": timing.p2_star_s,
        "nrc78_callback": on_pending,
        "logger_name": _LOGGER,
        "use_server_timing": False,  # its times do not include the bus and this machine
    }


class _Matching(BaseConnection):
    """A connection that passes on answers to the last request, and counts others."""

    def __init__(self, inner: BaseConnection, counts: DialogueCounts, goes_on: Callable[[], bool]) -> None:
        super().__init__("matching")
        self._inner = inner
        self._counts = counts
        self._goes_on = goes_on
        self._waiting = OpenRequests(belongs)
        self.request = self.stray = b""

    def begin(self, request: bytes) -> None:
        """Set the request whose answers are passed on."""
        self.request, self.stray = request, b""
        self._waiting.begin(request, time.monotonic())

    def open(self) -> "_Matching":
        self._inner.open()
        return self

    def close(self) -> None:
        self._inner.close()

    def is_open(self) -> bool:
        return self._inner.is_open()

    def empty_rxqueue(self) -> None:
        self._inner.empty_rxqueue()

    def specific_send(self, payload: bytes, timeout: float | None = None) -> None:
        del timeout
        self._inner.send(payload)

    def specific_wait_frame(self, timeout: float | None = None) -> bytes | None:
        until_s = time.monotonic() + (timeout or 0.0)
        while True:
            left_s = max(0.0, until_s - time.monotonic())
            try:
                payload = self._inner.specific_wait_frame(timeout=min(LOOK_S, left_s))
            except TimeoutException:
                if left_s <= LOOK_S:
                    raise
                payload = b""
            if not self._goes_on():
                raise StoppedError(STOPPED)
            if payload is None or is_pending(self.request, payload):
                return payload
            if payload and self._waiting.answered_by(payload) == self.request:
                return payload
            self._counts.stray += bool(payload)
            self.stray = payload or self.stray
