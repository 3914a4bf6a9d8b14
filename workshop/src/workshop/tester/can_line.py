"""One request at a time to controllers on a bus: answers are waited for, other testers are noticed."""

import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Final, cast

import can

from canlog.database.addressing import parameter_group
from canlog.errors import NOTICE
from diag_service.errors import ControllerError, SilentError, StoppedError
from diag_service.mapping.asked_signals import LATEST_NS, POSITIVE
from diag_service.settings.config import BusConfig
from workshop.tester.addresses import (
    FIXED_FUNCTIONAL,
    FIXED_PHYSICAL,
    FUNCTIONAL_ID,
    GROUP_REQUEST,
    LARGEST_ID,
    STANDARD_REQUESTS,
    TESTER_ADDRESS,
    TO_ALL,
    TOOLS,
    CanAddress,
    id_text,
    is_extended,
    is_request,
)
from workshop.tester.answers import MOST_PENDING_S, PENDING_S, OpenRequests, is_data_answer, is_pending
from workshop.tester.asking import opened_bus
from workshop.tester.dialogue import CanConnection, TimeoutException
from workshop.tester.listening import LISTEN_S, receive, send

GROUP_ANSWER_S: Final = 0.25  # SAE J1939-21: 0.2 s
REQUEST_PRIORITY: Final = 6
ANSWER_S: Final = LATEST_NS / 1e9  # a later answer is no sample
_LOG: Final = logging.getLogger(__name__)


class OtherTesterError(ControllerError):
    """Another tester is active: nothing more is sent."""


@dataclass(frozen=True, slots=True)
class GroupQuestion:
    """A request to all controllers for a parameter group of J1939."""

    pgn: int

    @property
    def address(self) -> "GroupQuestion":
        """Itself: the request goes to all."""
        return self

    @property
    def can_id(self) -> int:
        return REQUEST_PRIORITY << 26 | GROUP_REQUEST << 16 | TO_ALL << 8 | TOOLS[0]

    @property
    def request(self) -> bytes:
        return self.pgn.to_bytes(3, "little")

    def __str__(self) -> str:
        return f"PGN {self.pgn}"


class WatchedBus:
    """A bus that receives answers only.

    It raises OtherTesterError at a request of another tester.
    """

    def __init__(self, bus: can.BusABC, addresses: Sequence[CanAddress], groups: Sequence[int] = ()) -> None:
        self._bus = bus
        self._groups = frozenset(groups)
        self._answers = {address.response_id for address in addresses}
        self._requests = {address.request_id for address in addresses}
        wanted = {*self._answers, *self._requests, FUNCTIONAL_ID, *STANDARD_REQUESTS}
        masks = [
            (can_id, LARGEST_ID if is_extended(can_id) else 0x7FF, is_extended(can_id)) for can_id in sorted(wanted)
        ]
        masks += [(fixed | TESTER_ADDRESS, 0x1FFF_00FF, True) for fixed in (FIXED_PHYSICAL, FIXED_FUNCTIONAL & ~0xFFFF)]
        masks += [(GROUP_REQUEST << 16 | tool, 0x00FF_00FF, True) for tool in TOOLS]
        masks += [(pgn << 8, 0x03FF_FF00, True) for pgn in groups]
        filters = [{"can_id": can_id, "can_mask": mask, "extended": is_long} for can_id, mask, is_long in masks]
        bus.set_filters(filters)  # type: ignore[arg-type]  # as the library documents it

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next answer, None after the timeout; raises ControllerError if the bus cannot be read."""
        until_s = time.monotonic() + (timeout or 0.0)
        while True:
            message = receive(self._bus, max(0.0, until_s - time.monotonic()))
            if message is None or message.is_error_frame:
                return None
            can_id = message.arbitration_id
            if can_id in self._answers or (self._groups and parameter_group(can_id) in self._groups):
                return message
            if can_id in self._requests or is_request(can_id):
                raise OtherTesterError(f"another tester asks (requests on {id_text(can_id)})")

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        self._bus.send(message, timeout)

    def listen(self, duration_s: float, goes_on: Callable[[], bool]) -> None:
        """Wait until there was no other tester for so long [s]."""
        until_s = time.monotonic() + duration_s
        while (left_s := until_s - time.monotonic()) > 0.0:
            if not goes_on():
                raise StoppedError("stopped early")
            with suppress(OtherTesterError):
                self.recv(min(0.1, left_s))
                continue
            until_s = time.monotonic() + duration_s


class CanLine:
    """Controllers on a bus, one request at a time."""

    def __init__(self, bus: WatchedBus, *, is_fd: bool, goes_on: Callable[[], bool]) -> None:
        self._bus = cast("can.BusABC", bus)  # a connection uses `recv` and `send` only
        self._is_fd = is_fd
        self._goes_on = goes_on
        self._connections: dict[CanAddress, tuple[CanConnection, OpenRequests]] = {}
        self.patience: Counter[CanAddress] = Counter()  # requests that a controller answered with 78 first

    def ask(self, request: bytes, address: CanAddress) -> bytes | None:
        """Return the answer to a request; raises ControllerError, OtherTesterError.

        "Response pending" (78) if nothing else follows it in time; None: there is no answer.
        """
        if address not in self._connections:
            connection = CanConnection(self._bus, address, is_fd=self._is_fd, goes_on=self._goes_on)
            self._connections[address] = connection, OpenRequests(is_data_answer)
        connection, waiting = self._connections[address]
        connection.empty_rxqueue()
        try:
            connection.specific_send(request)
        except SilentError:
            return None
        begun_s, other, pending = time.monotonic(), None, None
        waiting.begin(request, begun_s)
        until_s = begun_s + ANSWER_S
        while (left_s := until_s - time.monotonic()) > 0.0:
            try:
                answer = connection.specific_wait_frame(left_s)
            except TimeoutException:
                break
            if is_pending(request, answer):  # this alone gives it more time: answers to others do not
                self.patience[address] += pending is None
                pending, until_s = answer, min(time.monotonic() + PENDING_S, begun_s + MOST_PENDING_S)
            elif (answered := waiting.answered_by(answer)) == request:
                return answer
            elif answered is None and answer[0] == request[0] + POSITIVE:
                other = answer  # of data that nobody asked for; used if nothing else comes
        return other or pending

    def ask_group(self, group: GroupQuestion) -> bytes | None:
        """Request a parameter group of all and return it, None after the timeout; raises ControllerError."""
        while self._bus.recv(0.0) is not None:
            pass  # frames from before the request
        send(self._bus, can.Message(arbitration_id=group.can_id, is_extended_id=True, data=group.request))
        until_s = time.monotonic() + GROUP_ANSWER_S
        while (left_s := until_s - time.monotonic()) > 0.0:
            message = self._bus.recv(left_s)
            if message is not None and message.is_extended_id and parameter_group(message.arbitration_id) == group.pgn:
                return bytes(message.data)
        return None


@contextmanager
def line_on(
    name: BusConfig | can.BusABC,
    addresses: Sequence[CanAddress],
    groups: Sequence[int] = (),
    *,
    is_fd: bool,
    listen_s: float = LISTEN_S,
    goes_on: Callable[[], bool] = lambda: True,
) -> Iterator[CanLine]:
    """Open a bus and wait until there is no other tester; raises SourceError, ControllerError, StoppedError."""
    with opened_bus(name) as bus:
        watched = WatchedBus(bus, addresses, groups)
        watched.listen(listen_s, goes_on)
        line = CanLine(watched, is_fd=is_fd, goes_on=goes_on)
        try:
            yield line
        finally:
            for address, count in line.patience.items():
                _LOG.log(
                    NOTICE, "%s asked for more time (78), requests: %d; such answers may be too late", address, count
                )
