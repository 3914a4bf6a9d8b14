"""A controller on a bus: ISO-TP (ISO 15765-2) by can-isotp, beside other traffic."""

import logging
import math
import queue
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import astuple, dataclass
from types import TracebackType
from typing import Final, Self

import can
import isotp

from ecu_emulator.errors import EmulatorConfigError
from workshop.controller.controller import TICK_S, Controller
from workshop.controller.inquiry import Asked, Inquiry, ThreadInquiry
from workshop.controller.iso14229 import NEGATIVE, Nrc
from workshop.controller.server import AGAIN_RATIO, KEEP_ALIVE, PENDING_RATIO
from workshop.isotp_frames import LARGEST_STANDARD_ID, TransportLayer, isotp_address, single_payload, usable

MOST_FRAMES: Final = 4096  # waiting frames; further ones are dropped and counted
MOST_REQUESTS: Final = 32  # waiting requests
LONGEST_MESSAGE: Final = 4095
TIMEOUT_MS: Final = 1000  # N_Bs and N_Cr
MOST_WAIT_FRAMES: Final = 1 << 31  # N_WFT_OVRN is an error of the receiver: a sender waits without limit
FULL_FD_BYTES: Final = 64
_LOGGER: Final = "ecu_emulator.isotp"  # invalid frames are counted instead of logged
logging.getLogger(_LOGGER).setLevel(logging.CRITICAL + 1)


@dataclass(slots=True)
class LinkCounts:
    requests: int = 0
    responses: int = 0
    ignored_frames: int = 0  # invalid or out of sequence
    broken_messages: int = 0  # received or sent incompletely
    dropped_frames: int = 0  # queue was full
    dropped_requests: int = 0
    unsent_frames: int = 0  # the bus refused them


class DiagnosticLink:
    """Answers while the ``with`` block runs, at its own pace, the only user of the transport layer.

    Parameters
    ----------
    controller
        The controller that answers.
    send
        Puts a frame on the bus; may raise ``can.CanError``.
    is_fd
        Whether responses go out in CAN FD frames.
    inquiry
        In whose time the controller is asked, entered elsewhere; that of this machine by default.

    Raises
    ------
    ConfigError
        If the transport layer refuses the settings of the table.
    """

    def __init__(
        self,
        controller: Controller,
        send: Callable[[can.Message], None],
        *,
        is_fd: bool = False,
        inquiry: Inquiry | None = None,
    ) -> None:
        self._controller = controller
        self._inquiry, self._is_owner = (ThreadInquiry(), True) if inquiry is None else (inquiry, False)
        self._pace = self._inquiry.pace
        self._send = send
        self._is_fd = is_fd
        self._ids = controller.table.addressing
        self._transport = controller.table.transport
        self._prefix_bytes = 0 if self._transport.own_address is None else 1
        self._frames: queue.Queue[can.Message | None] = queue.Queue(MOST_FRAMES)
        self._requests: deque[tuple[bytes, bool]] = deque()
        self._next: isotp.CanMessage | None = None
        self._asking: Asked | None = None
        self._asked, self._pending_s, self._has_promised = b"", 0.0, False
        self._next_tick_s = -math.inf
        self._stack = ExitStack()
        self._layer = self._made_layer()
        self.counts = LinkCounts()

    def _made_layer(self) -> isotp.TransportLayerLogic:
        transport = self._transport
        try:
            return TransportLayer(
                self._pace.now_s,
                rxfn=self._take_frame,
                txfn=self._send_frame,
                address=isotp_address(
                    self._ids.response_id,
                    self._ids.request_id,
                    transport.own_address or 0,
                    None if transport.own_address is None else transport.tester_address,
                ),
                error_handler=self._count_broken,
                params={
                    "stmin": transport.separation_time,
                    "blocksize": transport.block_size,
                    "tx_padding": transport.padding,
                    "tx_data_min_length": None if transport.padding is None else 8,
                    "tx_data_length": FULL_FD_BYTES if self._is_fd else 8,
                    "can_fd": self._is_fd,
                    "bitrate_switch": self._is_fd,
                    "max_frame_size": LONGEST_MESSAGE,
                    "rx_flowcontrol_timeout": TIMEOUT_MS,
                    "rx_consecutive_frame_timeout": TIMEOUT_MS,
                    "wftmax": MOST_WAIT_FRAMES,
                    "logger_name": _LOGGER,
                },
            )
        except ValueError as exc:
            raise EmulatorConfigError(f"diagnostics: {exc}") from exc

    @property
    def can_ids(self) -> tuple[int, int]:
        """Identifiers of the frames that ``feed`` wants."""
        return self._ids.request_id, self._ids.functional_id

    def __enter__(self) -> Self:
        if self._is_owner:
            self._stack.enter_context(self._inquiry)
        self._stack.enter_context(self._pace.listening(self._serve, "diagnostics"))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def feed(self, message: can.Message) -> None:
        """Queue a frame from the bus; safe for any thread; frames for others are ignored."""
        if message.is_error_frame or message.is_remote_frame or message.arbitration_id not in self.can_ids:
            return
        if message.is_extended_id != (message.arbitration_id > LARGEST_STANDARD_ID):
            return
        try:
            self._frames.put_nowait(message)
        except queue.Full:
            self.counts.dropped_frames += 1

    def _serve(self, patience_s: float) -> bool:
        """Take a frame, if one comes for so long [s], and do what is due; return whether further frames wait."""
        self._process_next(min(patience_s, self._patience_s()))
        self._layer.process()
        while (received := self._layer.recv()) is not None:
            self._enqueue(bytes(received), is_functional=False)
        now_s = self._pace.now_s()
        self._process_requests(now_s)
        if now_s >= self._next_tick_s:
            self._next_tick_s = now_s + TICK_S
            if self._layer.transmitting() or self._layer.is_rx_active():
                self._controller.hold_session()
            self._respond(self._controller.tick())
        self._layer.process()
        return not self._frames.empty()

    def _patience_s(self) -> float:
        """Return how long to wait for a frame [s]: until the next frame of a response is due."""
        due_s = self._layer.next_cf_delay()
        return TICK_S if due_s is None else min(TICK_S, due_s)

    def _process_next(self, patience_s: float) -> None:
        """Pass the next frame to the transport layer, or queue it if it is a functional request."""
        try:
            message = self._frames.get(timeout=patience_s) if patience_s > 0.0 else self._frames.get_nowait()
        except queue.Empty:
            return
        if message is None:
            return
        data = bytes(message.data)
        if message.arbitration_id == self._ids.functional_id:
            self._process_functional(data)
            return
        usable_data = usable(data, self._prefix_bytes, self._layer.rx_frame_length - len(self._layer.rx_buffer))
        if usable_data is None:
            self.counts.ignored_frames += 1
            return
        self._next = isotp.CanMessage(
            arbitration_id=message.arbitration_id,
            data=usable_data,
            extended_id=message.is_extended_id,
            is_fd=message.is_fd,
        )

    def _process_functional(self, data: bytes) -> None:
        """Queue a functional request, which is a single frame: there is no flow control to many."""
        payload = single_payload(data, self._prefix_bytes)
        if payload is None or (self._prefix_bytes and data[0] != self._transport.all_address):
            self.counts.ignored_frames += 1
            return
        self._enqueue(payload, is_functional=True)

    def _enqueue(self, payload: bytes, *, is_functional: bool) -> None:
        """Queue a request until the last response is sent; a KEEP_ALIVE meanwhile is only counted."""
        if payload == KEEP_ALIVE and self._layer.transmitting():
            self.counts.requests += 1
        elif len(self._requests) >= MOST_REQUESTS:
            self.counts.dropped_requests += 1
        else:
            self._requests.append((payload, is_functional))

    def _process_requests(self, now_s: float) -> None:
        """Pass the next request to the controller and its response to the client; send 78 if saving takes long."""
        if self._asking is None and self._requests and not self._layer.transmitting():
            self._asked, is_functional = self._requests.popleft()
            self.counts.requests += 1
            self._pending_s, self._has_promised = now_s + PENDING_RATIO * self._controller.table.timing.p2_s, False
            self._asking = self._inquiry.ask(self._controller, self._asked, is_functional, self._wake)
        if self._asking is None:
            return
        if self._asking.done():
            reply, self._asking = self._asking.result(), None
            self._respond(reply.response(was_promised=self._has_promised))
        elif now_s >= self._pending_s and self._asked != KEEP_ALIVE:
            self._pending_s, self._has_promised = now_s + AGAIN_RATIO * self._controller.table.timing.p2_star_s, True
            self._respond(bytes([NEGATIVE, self._asked[0], Nrc.RESPONSE_PENDING]))

    def _wake(self) -> None:
        with suppress(queue.Full):
            self._frames.put_nowait(None)

    def _respond(self, payload: bytes | None) -> None:
        if payload is not None:
            self.counts.responses += 1
            self._layer.send(payload)

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
        try:
            self._send(message)
        except can.CanError:
            self.counts.unsent_frames += 1

    def _count_broken(self, _error: Exception) -> None:
        self.counts.broken_messages += 1


class Links:
    """Several controllers at one end of a bus; each link is entered for itself."""

    def __init__(self, *links: DiagnosticLink) -> None:
        self._links = links

    @property
    def can_ids(self) -> tuple[int, ...]:
        """Identifiers of the frames that ``feed`` wants."""
        return tuple({can_id for link in self._links for can_id in link.can_ids})

    @property
    def counts(self) -> LinkCounts:
        """Counts of all controllers together."""
        return LinkCounts(*map(sum, zip(*(astuple(link.counts) for link in self._links), strict=True)))

    def feed(self, message: can.Message) -> None:
        """Pass a frame from the bus to each; safe for any thread."""
        for link in self._links:
            link.feed(message)
