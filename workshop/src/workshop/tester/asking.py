"""Listen first who else is asking on a bus, then ask: what commands, polling and Python do with one controller."""

import contextvars
import ipaddress
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Final, Self

import can

from canlog.live.opening import complete_settings
from canlog.live.pythoncan import one_line, open_bus
from diag_service.errors import ConfigError, ControllerError, StoppedError
from diag_service.settings.config import BusConfig
from workshop.tester.addresses import TRANSMISSION, CanAddress, id_text, is_extended, is_request, usual_response_id
from workshop.tester.answers import TesterTiming
from workshop.tester.description import Description

if TYPE_CHECKING:
    from workshop.tester.dialogue import Dialogue

LISTEN_S: Final = 5.0  # S3 of a controller (ISO 14229-2): a tester that keeps a session speaks at least so often
CLASSIC_BYTES: Final = 8  # of a frame of a request
PADDING: Final = 0xCC  # what fills it, ISO 15765-2: the bits stuffed least
_PATIENCE_S: Final = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class HeardTraffic:
    """What was heard."""

    duration_s: float
    frame_count: int
    can_ids: frozenset[int]
    error_count: int = 0  # frames that tell of trouble on the bus

    def __str__(self) -> str:
        if not self.frame_count:
            return f"nothing was heard in {self.duration_s:g} s"
        rate_hz = self.frame_count / self.duration_s
        return f"{self.frame_count} frames of {len(self.can_ids)} identifiers in {self.duration_s:g} s, {rate_hz:.0f}/s"

    def other_testers(self, address: CanAddress | None = None) -> tuple[int, ...]:
        """Return the identifiers by which somebody else asks: those of the standard, and that of an address."""
        own = set() if address is None else {address.request_id}
        return tuple(sorted(can_id for can_id in self.can_ids if is_request(can_id) or can_id in own))


def send(bus: can.BusABC, message: can.Message) -> None:
    """Put a frame on a bus; raises ControllerError if the bus does not take it."""
    try:
        bus.send(message, timeout=1.0)
    except (can.CanError, OSError, ValueError) as exc:
        raise ControllerError(f"the bus does not take a request: {one_line(exc)}") from exc


def receive(bus: can.BusABC, patience_s: float) -> can.Message | None:
    """Return the next frame, None if none comes in time; raises ControllerError if the bus cannot be read."""
    try:
        return bus.recv(patience_s)
    except (can.CanError, OSError, ValueError) as exc:
        raise ControllerError(f"the bus cannot be read: {one_line(exc)}") from exc


def listen(bus: can.BusABC, duration_s: float = LISTEN_S, goes_on: Callable[[], bool] = lambda: True) -> HeardTraffic:
    """Return what is heard on a bus for so long.

    Raises ControllerError if it cannot be read, StoppedError if it shall not go on.
    """
    until_s = time.monotonic() + duration_s
    frame_count = error_count = 0
    can_ids = set[int]()
    while (left_s := until_s - time.monotonic()) > 0.0:
        if not goes_on():
            raise StoppedError("stopped early: nothing was asked")
        message = receive(bus, min(_PATIENCE_S, left_s))
        if message is None:
            continue
        if message.is_error_frame:
            error_count += 1
            continue
        frame_count += 1
        can_ids.add(message.arbitration_id)
    return HeardTraffic(
        duration_s=duration_s, frame_count=frame_count, can_ids=frozenset(can_ids), error_count=error_count
    )


def check_alone(traffic: HeardTraffic, address: CanAddress | None = None) -> None:
    """Raise ControllerError if another tester was heard: two on one bus take each other's answers."""
    if others := traffic.other_testers(address):
        named = ", ".join(map(id_text, others))
        raise ControllerError(f"another tester is asking on this bus (requests on {named}): nothing was asked")


DOIP_PORT: Final = 13400
CONNECT_S: Final = 5.0
LARGEST_LOGICAL: Final = 0xFFFF
MOST_WAITING: Final = 100_000  # frames on a bus that was handed over, from before anybody listened
_LARGEST_PORT: Final = 0xFFFF
LONGEST_S: Final = 3600.0
JOIN_S: Final = 3.0  # how long an ending service waits for a question that is under way
SHORTEST_ANSWER_S: Final = 0.001


@dataclass(frozen=True, slots=True, kw_only=True)
class DoipPlace:
    """Where a node listens, and its logical address."""

    host: str
    port: int = DOIP_PORT
    logical_address: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.logical_address:04X} at DoIP {host}:{self.port}"


def parse_doip(text: str, logical_address: int) -> DoipPlace:
    """Return the place that ``HOST[:PORT]`` names, an address of IPv4 or, in brackets, of IPv6; raises ConfigError."""
    host, colon, port = text, "", ""
    if not text.startswith("[") or "]:" in text:
        host, colon, port = text.rpartition(":") if ":" in text else (text, "", "")
    host = host.strip("[]")
    try:
        ipaddress.ip_address(host)
    except ValueError as exc:
        raise ConfigError(f"--doip must be an IP address with or without :PORT, got {text!r}") from exc
    if colon and not (port.isdecimal() and 0 < int(port) <= _LARGEST_PORT):
        raise ConfigError(f"--doip: the port must be 1..{_LARGEST_PORT}, got {port!r}")
    return DoipPlace(host=host, port=int(port) if colon else DOIP_PORT, logical_address=logical_address)


def address_for(named: CanAddress | None, description: Description) -> CanAddress:
    """Return where to ask: as named, or as described, or where the standard has the transmission."""
    if named is not None:
        return named
    request_id = TRANSMISSION if description.request_id is None else description.request_id
    response_id = usual_response_id(request_id) if description.response_id is None else description.response_id
    return CanAddress(request_id=request_id, response_id=response_id)


def check_libraries() -> None:
    """Raise ExtraMissingError if a library that asks is missing; what imports this can be imported without."""
    import_module("workshop.tester.dialogue")


@contextmanager
def opened_bus(place: BusConfig | can.BusABC) -> Iterator[can.BusABC]:
    """Open a bus for the time of the block; one that is open is lent, and stays open with the filters that it had.

    Meanwhile it has none: behind them another tester could not be heard.

    Raises
    ------
    ExtraMissingError
        If a library that asks is missing.
    SourceError
        If it is not named or cannot be opened.
    ControllerError
        If one that is open cannot be read.
    """
    check_libraries()
    if not isinstance(place, BusConfig):
        filters = place.filters
        try:
            place.set_filters(None)
            for _ in range(MOST_WAITING):  # from before anybody listened: a tester of long ago disturbs nobody
                if receive(place, 0.0) is None:
                    break
            yield place
        finally:
            place.set_filters(filters)
        return
    settings = complete_settings(place.interface, place.channel, place.bitrate, fd=place.is_fd)
    bus = open_bus(settings.interface, settings.channel, settings.bitrate, fd=settings.fd)
    try:
        yield bus
    finally:
        bus.shutdown()


def dialogue_on(
    bus: can.BusABC,
    address: CanAddress,
    timing: TesterTiming,
    *,
    is_fd: bool = False,
    goes_on: Callable[[], bool] = lambda: True,
) -> "Dialogue":
    """Return a tester for one controller; from now on the bus gives no more than that controller's frames."""
    from workshop.tester.dialogue import CanConnection, Dialogue  # noqa: PLC0415 - libraries of an extra

    mask = 0x1FFF_FFFF if is_extended(address.response_id) else 0x7FF
    bus.set_filters([{"can_id": address.response_id, "can_mask": mask, "extended": is_extended(address.response_id)}])
    return Dialogue(CanConnection(bus, address, is_fd=is_fd, goes_on=goes_on), str(address), timing, goes_on=goes_on)


@contextmanager
def dialogue_over_ip(
    place: DoipPlace, timing: TesterTiming, *, goes_on: Callable[[], bool] = lambda: True
) -> Iterator["Dialogue"]:
    """Connect to a node for the time of the block.

    Raises
    ------
    ControllerError
        If it is not there, is another or refuses.
    ExtraMissingError
        If doipclient is not installed.
    """
    from workshop.tester.dialogue import (  # noqa: PLC0415 - likewise
        Dialogue,
        DoipNode,
        connector,
    )

    try:
        with socket.create_connection((place.host, place.port), timeout=CONNECT_S):
            pass  # the library would leave sockets open if nobody listens there
        node = DoipNode(place.host, place.logical_address, tcp_port=place.port, udp_port=place.port)
    except (OSError, ValueError) as exc:
        raise ControllerError(f"{place}: {' '.join(str(exc).split())}") from exc
    try:
        with Dialogue(connector(node), str(place), timing, goes_on=goes_on) as tester:
            yield tester
    finally:
        node.close()


class AskingThread(ABC):
    """What asks in a thread of its own while it is entered; ``_run`` is to end soon after ``goes_on`` has."""

    def __init__(self, name: str) -> None:
        self._is_over = threading.Event()
        context = contextvars.copy_context()  # what is said belongs to whoever makes this
        self._thread = threading.Thread(target=context.run, args=(self._run,), name=name, daemon=True)

    @property
    def goes_on(self) -> bool:
        return not self._is_over.is_set()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> None:
        """Ask no more; wait a little for a question that is under way."""
        self._is_over.set()
        self._thread.join(JOIN_S)

    @abstractmethod
    def _run(self) -> None:
        """Ask until it is over."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BusTarget:
    """One controller on a bus."""

    bus: BusConfig | can.BusABC
    address: CanAddress
    is_fd: bool = False  # whether requests go out in CAN FD frames
    listen_s: float = LISTEN_S  # before anything is sent


@contextmanager
def asking(
    target: BusTarget | DoipPlace, timing: TesterTiming, *, goes_on: Callable[[], bool] = lambda: True
) -> "Iterator[tuple[Dialogue, HeardTraffic | None]]":
    """Listen, then be ready to ask for the time of the block; yield the tester, and what it heard on a bus before.

    Raises SourceError, ControllerError if the bus cannot be used, another tester is at work, or a node is not there,
    ExtraMissingError if a library is missing.

    Parameters
    ----------
    goes_on
        Asked while an answer is waited for; False ends that with StoppedError.
    """
    if isinstance(target, DoipPlace):
        with dialogue_over_ip(target, timing, goes_on=goes_on) as tester:
            yield tester, None
        return
    with opened_bus(target.bus) as bus:
        traffic = listen(bus, target.listen_s, goes_on)
        check_alone(traffic, target.address)
        with dialogue_on(bus, target.address, timing, is_fd=target.is_fd, goes_on=goes_on) as tester:
            yield tester, traffic


def heard(
    place: BusConfig | can.BusABC | DoipPlace, listen_s: float, goes_on: Callable[[], bool] = lambda: True
) -> HeardTraffic | None:
    """Return what is heard where something would be asked; None: over IP there is nothing to hear.

    Raises SourceError, ControllerError if the bus cannot be used.
    """
    if isinstance(place, DoipPlace):
        return None
    with opened_bus(place) as bus:
        return listen(bus, listen_s, goes_on)


def check_time(name: str, value_s: float, *, least_s: float) -> None:
    """Raise ConfigError unless a time is usable [s]."""
    if not least_s <= value_s <= LONGEST_S:
        raise ConfigError(f"{name} must be {least_s:g} to {LONGEST_S:g} s, got {value_s:g}")


def timing_of(listen_s: float, timeout_s: float) -> TesterTiming:
    """Return how patient the tester is to be; raises ConfigError if a time cannot be."""
    check_time("listen", listen_s, least_s=0.0)
    check_time("timeout", timeout_s, least_s=SHORTEST_ANSWER_S)
    return TesterTiming(p2_s=timeout_s)
