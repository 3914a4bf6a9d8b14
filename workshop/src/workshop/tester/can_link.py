"""Messages of ISO-TP (ISO 15765-2) to and from one controller on an open bus, in the caller's thread."""

import logging
import time
from collections.abc import Callable
from typing import Final

import can

from diag_service.errors import SilentError, StoppedError
from workshop.tester.addresses import CanAddress, is_extended
from workshop.tester.answers import STOPPED, request_text
from workshop.tester.libraries import BaseConnection, TimeoutException, isotp
from workshop.tester.listening import CLASSIC_BYTES, PADDING, receive, send

LONGEST_MESSAGE: Final = 65_535
TIMEOUT_MS: Final = 1000  # N_Bs and N_Cr
MOST_WAIT_FRAMES: Final = 100  # of a controller that is busy receiving
FD_BYTES: Final = 64
MOST_OLD_FRAMES: Final = 10_000  # thrown away before a request
LONGEST_RECEPTION_S: Final = 60.0  # of one message, whose frames come within their own timeout
PATIENCE_S: Final = 0.05
_BREAKS: Final = (isotp.errors.ConsecutiveFrameTimeoutError, isotp.errors.WrongSequenceNumberError)
_LOGGER: Final = "diag_service.isotp"  # the library warns of every odd frame
logging.getLogger(_LOGGER).setLevel(logging.CRITICAL + 1)


class CanConnection(BaseConnection):
    """What `udsoncan` asks through; the bus stays its owner's.

    Parameters
    ----------
    bus, address
        An open bus, and who is asked on it.
    is_fd
        Whether requests go out in CAN FD frames.
    goes_on
        Asked while a message is on its way; False ends that with StoppedError.
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
            rxfn=self._taken,
            txfn=self._put,
            address=_isotp_address(address),
            error_handler=self._note,
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
                "logger_name": _LOGGER,
            },
        )

    def open(self) -> "CanConnection":
        self._is_open = True
        return self

    def close(self) -> None:
        """End; the bus stays open."""
        self._is_open = False

    def is_open(self) -> bool:
        return self._is_open

    def empty_rxqueue(self) -> None:
        """Forget what came before a request."""
        for _ in range(MOST_OLD_FRAMES):
            if self._receive(0.0) is None:
                break
        self._layer.reset()

    def specific_send(self, payload: bytes, timeout: float | None = None) -> None:
        """Send a request, in as many frames as it takes.

        Raises SilentError if the controller does not say in time that it goes on receiving, ControllerError if the bus
        does not take it.
        """
        del timeout  # the transport layer has its own
        self._is_sent_in_part = False
        self._layer.send(payload)
        self._layer.process()
        while self._layer.transmitting():
            self._turn(PATIENCE_S)
        if self._is_sent_in_part:
            raise SilentError(f"{self._address} does not take the whole of the request {request_text(payload)}")

    def specific_wait_frame(self, timeout: float | None = None) -> bytes:
        """Return the next message; one that has begun in time may take its time.

        Raises
        ------
        TimeoutException
            If none begins in time.
        SilentError
            If one begins and breaks off.
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
            self._turn(min(PATIENCE_S, left_s))
            if self._is_broken_off:
                raise SilentError(f"{self._address} began an answer and broke it off")
        return bytes(message)

    def _turn(self, patience_s: float) -> None:
        """Let the transport layer see the next frame for it, if one comes, and do what is due."""
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

    def _taken(self, _timeout_s: float) -> isotp.CanMessage | None:
        message, self._next = self._next, None
        return message

    def _put(self, frame: isotp.CanMessage) -> None:
        message = can.Message(
            arbitration_id=frame.arbitration_id,
            is_extended_id=frame.is_extended_id,
            is_fd=frame.is_fd,
            bitrate_switch=frame.bitrate_switch,
            data=frame.data,
        )
        send(self._bus, message)

    def _note(self, error: Exception) -> None:
        self._is_sent_in_part = True
        self._is_broken_off |= isinstance(error, _BREAKS)


def _isotp_address(address: CanAddress) -> isotp.Address:
    has_29_bits = is_extended(address.request_id)
    if address.target_byte is None:
        mode = isotp.AddressingMode.Normal_29bits if has_29_bits else isotp.AddressingMode.Normal_11bits
        return isotp.Address(mode, txid=address.request_id, rxid=address.response_id)
    mode = isotp.AddressingMode.Extended_29bits if has_29_bits else isotp.AddressingMode.Extended_11bits
    return isotp.Address(
        mode,
        txid=address.request_id,
        rxid=address.response_id,
        source_address=address.tester_byte,
        target_address=address.target_byte,
    )
