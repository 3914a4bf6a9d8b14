"""From what a user names to a tester that may ask: a bus that was listened to, or a connection over IP."""

import ipaddress
import socket
import ssl
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final

import can

from canlog.extras import load_extra
from canlog.live.factory import complete_settings
from canlog.live.pythoncan import one_line, open_bus
from canlog.plain_files import check_plain_file
from diag_service.errors import ConfigError, ControllerError
from diag_service.tester.addresses import TRANSMISSION, CanAddress, is_extended, usual_response_id
from diag_service.tester.description import Description
from diag_service.tester.manners import Manners

if TYPE_CHECKING:
    from diag_service.tester.dialogue import Dialogue

EXTRA: Final = "uds"
DOIP_PORT: Final = 13400
DOIP_TLS_PORT: Final = 3496
CONNECT_S: Final = 5.0
LARGEST_LOGICAL: Final = 0xFFFF
MOST_WAITING: Final = 100_000  # frames on a bus that was handed over, from before anybody listened
_LARGEST_PORT: Final = 0xFFFF


@dataclass(frozen=True, slots=True, kw_only=True)
class BusName:
    """Which bus to open; None leaves the choice to python-can's configuration."""

    interface: str | None
    channel: str | None
    bitrate: int | None
    is_fd: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class DoipPlace:
    """Where a node listens, and its logical address."""

    host: str
    port: int = DOIP_PORT
    authority: Path | None = None  # TLS, with nodes whose certificate it has signed
    logical_address: int

    def __str__(self) -> str:
        """Return it for people."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.logical_address:04X} at DoIP {host}:{self.port}"


def parse_doip(text: str, logical_address: int, authority: Path | None = None) -> DoipPlace:
    """Return the place that ``HOST[:PORT]`` names, an address of IPv4 or, in brackets, of IPv6.

    With an authority it is asked by TLS.

    Raises
    ------
    ConfigError
        If it is none.
    """
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
    usual = DOIP_PORT if authority is None else DOIP_TLS_PORT
    return DoipPlace(
        host=host, port=int(port) if colon else usual, logical_address=logical_address, authority=authority
    )


def address_for(named: CanAddress | None, description: Description) -> CanAddress:
    """Return where to ask: as named, or as described, or where the standard has the transmission."""
    if named is not None:
        return named
    request_id = TRANSMISSION if description.request_id is None else description.request_id
    response_id = usual_response_id(request_id) if description.response_id is None else description.response_id
    return CanAddress(request_id=request_id, response_id=response_id)


def check_libraries() -> None:
    """Raise ExtraMissingError if a library that asks is missing; what imports this can be imported without."""
    import_module("diag_service.tester.libraries")


@contextmanager
def opened_bus(place: BusName | can.BusABC) -> Iterator[can.BusABC]:
    """Open a bus for the time of the block; one that is open is lent, and stays open with the filters that it had.

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
    if not isinstance(place, BusName):
        filters = place.filters
        _forget_waiting(place)
        try:
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


def _forget_waiting(bus: can.BusABC) -> None:
    """Read what came before anybody listened: a tester that was here long ago disturbs nobody."""
    try:
        for _ in range(MOST_WAITING):
            if bus.recv(0.0) is None:
                return
    except (can.CanError, OSError, ValueError) as exc:
        raise ControllerError(f"the bus cannot be read: {one_line(exc)}") from exc


def dialogue_on(
    bus: can.BusABC,
    address: CanAddress,
    manners: Manners,
    *,
    is_fd: bool = False,
    goes_on: Callable[[], bool] = lambda: True,
) -> "Dialogue":
    """Return a tester for one controller; from now on the bus gives no more than that controller's frames."""
    from diag_service.tester.can_link import CanConnection  # noqa: PLC0415 - libraries of an extra
    from diag_service.tester.dialogue import Dialogue  # noqa: PLC0415 - likewise

    mask = 0x1FFF_FFFF if is_extended(address.response_id) else 0x7FF
    bus.set_filters([{"can_id": address.response_id, "can_mask": mask, "extended": is_extended(address.response_id)}])
    return Dialogue(CanConnection(bus, address, is_fd=is_fd, goes_on=goes_on), str(address), manners, goes_on=goes_on)


@contextmanager
def dialogue_over_ip(
    place: DoipPlace, manners: Manners, *, goes_on: Callable[[], bool] = lambda: True
) -> Iterator["Dialogue"]:
    """Connect to a node for the time of the block.

    Raises
    ------
    ConfigError, ControllerError
        If the authority cannot be used; if it is not there, is another or refuses.
    ExtraMissingError
        If doipclient is not installed.
    """
    from diag_service.tester.dialogue import Dialogue  # noqa: PLC0415 - libraries of an extra

    doipclient = load_extra("doipclient", "DoIP needs doipclient", EXTRA)
    connectors = load_extra("doipclient.connectors", "DoIP needs doipclient", EXTRA)
    try:
        context = None if place.authority is None else _tls_context(place.authority)
        _find(place, context)
        node = doipclient.DoIPClient(
            place.host, place.logical_address, tcp_port=place.port, udp_port=place.port, use_secure=context or False
        )
    except (OSError, ValueError) as exc:
        raise ControllerError(f"{place}: {' '.join(str(exc).split())}") from exc
    try:
        with Dialogue(connectors.DoIPClientUDSConnector(node), str(place), manners, goes_on=goes_on) as tester:
            yield tester
    finally:
        node.close()


def _tls_context(authority: Path) -> ssl.SSLContext:
    """Return what a connection is made with; names are not compared: nodes have addresses, not names."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        check_plain_file(authority)
        context.load_verify_locations(authority)
    except ssl.SSLError as exc:
        raise ConfigError(f"authority {authority} is no certificate: {exc.reason or exc}") from exc
    except OSError as exc:
        raise ConfigError(f"cannot read authority {authority}: {exc.strerror or exc}") from exc
    return context


def _find(place: DoipPlace, context: ssl.SSLContext | None) -> None:
    """Raise OSError if nobody listens there, or is another; the library would leave sockets open."""
    with socket.create_connection((place.host, place.port), timeout=CONNECT_S) as connection:
        if context is not None:
            context.wrap_socket(connection).close()
