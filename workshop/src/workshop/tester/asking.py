"""Access to one controller for commands, polling and Python: listen for other testers first, then ask."""

import contextvars
import ipaddress
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Final, Self
from urllib.parse import urlsplit

import can

from canlog.live.opening import complete_settings
from canlog.live.pythoncan import open_bus
from diag_service.errors import ConfigError, ControllerError
from diag_service.settings.config import BusConfig
from workshop.tester.addresses import TRANSMISSION, CanAddress, is_extended, usual_response_id
from workshop.tester.answers import TesterTiming
from workshop.tester.description import Description
from workshop.tester.listening import LISTEN_S, HeardTraffic, check_alone, listen, receive

if TYPE_CHECKING:
    from workshop.tester.dialogue import Dialogue

DOIP_PORT: Final = 13400
CONNECT_S: Final = 5.0
LARGEST_LOGICAL: Final = 0xFFFF
MOST_WAITING: Final = 100_000  # old frames dropped from a bus that was passed in
LONGEST_S: Final = 3600.0
JOIN_S: Final = 3.0  # time to end a request in progress
SHORTEST_ANSWER_S: Final = 0.001


@dataclass(frozen=True, slots=True, kw_only=True)
class DoipPlace:
    """Host, port and logical address of a DoIP node."""

    host: str
    port: int = DOIP_PORT
    logical_address: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.logical_address:04X} at DoIP {host}:{self.port}"


def parse_doip(text: str, logical_address: int) -> DoipPlace:
    """Return the place that ``HOST[:PORT]`` names, an address of IPv4 or, in brackets, of IPv6; raises ConfigError."""
    try:
        parts = urlsplit(f"//{text}")
        host, port = str(ipaddress.ip_address(parts.hostname or "")), parts.port
    except ValueError as exc:
        raise ConfigError(f"--doip must be an IP address with or without :PORT, got {text!r}") from exc
    return DoipPlace(host=host, port=DOIP_PORT if port is None else port, logical_address=logical_address)


def address_for(named: CanAddress | None, description: Description) -> CanAddress:
    """Return the given address, or that of the description, or that of the transmission by the standard."""
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
    """Open a bus for the block; an open one is used without its filters, which would hide other testers.

    It stays open, and gets its filters back.

    Raises
    ------
    ExtraMissingError
        If a library of the tester is missing.
    SourceError
        If the bus is not named or cannot be opened.
    ControllerError
        If an open bus cannot be read.
    """
    check_libraries()
    if not isinstance(place, BusConfig):
        filters = place.filters
        try:
            place.set_filters(None)
            for _ in range(MOST_WAITING):  # old frames, also of testers that have gone
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
    """Return a dialogue with one controller; from now on the bus receives its frames only."""
    from workshop.tester.dialogue import CanConnection, Dialogue  # noqa: PLC0415 - libraries of an extra

    mask = 0x1FFF_FFFF if is_extended(address.response_id) else 0x7FF
    bus.set_filters([{"can_id": address.response_id, "can_mask": mask, "extended": is_extended(address.response_id)}])
    return Dialogue(CanConnection(bus, address, is_fd=is_fd, goes_on=goes_on), str(address), timing, goes_on=goes_on)


@contextmanager
def dialogue_over_ip(
    place: DoipPlace, timing: TesterTiming, *, goes_on: Callable[[], bool] = lambda: True
) -> Iterator["Dialogue"]:
    """Connect to a node for the block.

    Raises
    ------
    ControllerError
        If the node is missing, has another address or refuses.
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
    """A thread of requests while it is entered; ``_run`` must end soon after ``goes_on`` is False."""

    def __init__(self, name: str) -> None:
        self._is_over = threading.Event()
        context = contextvars.copy_context()  # log records belong to the caller
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
        """Stop, and wait up to `JOIN_S` for a request in progress."""
        self._is_over.set()
        self._thread.join(JOIN_S)

    @abstractmethod
    def _run(self) -> None:
        """Send requests until the end."""


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
    """Listen, then yield a dialogue, and the traffic on the bus before.

    Raises SourceError, ControllerError if the bus cannot be used, another tester is active, or a node is missing,
    ExtraMissingError if a library is missing.

    Parameters
    ----------
    goes_on
        Called while it waits; False ends that with StoppedError.
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


def listen_at(
    place: BusConfig | can.BusABC | DoipPlace, listen_s: float, goes_on: Callable[[], bool] = lambda: True
) -> HeardTraffic | None:
    """Return the traffic on a bus; None over IP.

    Raises SourceError, ControllerError if the bus cannot be used.
    """
    if isinstance(place, DoipPlace):
        return None
    with opened_bus(place) as bus:
        return listen(bus, listen_s, goes_on)


def check_time(name: str, value_s: float, *, least_s: float) -> None:
    """Raise ConfigError unless a time is in its range [s]."""
    if not least_s <= value_s <= LONGEST_S:
        raise ConfigError(f"{name} must be {least_s:g} to {LONGEST_S:g} s, got {value_s:g}")


def timing_of(listen_s: float, timeout_s: float) -> TesterTiming:
    """Return the timing of the tester; raises ConfigError if a time is out of range."""
    check_time("listen", listen_s, least_s=0.0)
    check_time("timeout", timeout_s, least_s=SHORTEST_ANSWER_S)
    return TesterTiming(p2_s=timeout_s)
