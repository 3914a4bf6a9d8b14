"""The sockets of an entity: for connections, by TLS as well, and for datagrams; and where announcements go."""

import socket
import ssl
from contextlib import ExitStack
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv6Address
from pathlib import Path
from typing import Final

from canlog.files import check_plain_file
from ecu_emulator.errors import BusError, ConfigError

LARGEST_PORT: Final = 65535


@dataclass(frozen=True, slots=True, kw_only=True)
class TlsNode:
    """Where an entity speaks TLS, and the files (PEM) by which testers know it."""

    certificate: Path
    key: Path | None  # None: it is in the file of the certificate
    port: int

    def context(self) -> ssl.SSLContext:
        """Return what connections are made with: TLS 1.2 or newer, as the standard has it.

        Raises ConfigError if a file cannot be read, or is no certificate or the wrong key.
        """
        files = ", ".join(str(path) for path in (self.certificate, self.key) if path is not None)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            for path in (self.certificate, self.key):
                if path is not None:
                    check_plain_file(path)
            context.load_cert_chain(self.certificate, self.key, password="")  # or a terminal would be asked
        except ssl.SSLError as exc:
            raise ConfigError(f"certificate or key cannot be used: {exc.reason or exc} ({files})") from exc
        except OSError as exc:
            raise ConfigError(f"certificate or key cannot be read: {exc.strerror or exc} ({files})") from exc
        return context


def tls_node(certificate: Path | None, key: Path | None, port: int) -> TlsNode | None:
    """Return how TLS is spoken, as the command line says; None if it is not.

    Raises ConfigError if there is a key without a certificate, or the port is none.
    """
    if certificate is None:
        if key is not None:
            raise ConfigError("--doip-key needs --doip-certificate")
        return None
    if not 1 <= port <= LARGEST_PORT:
        raise ConfigError(f"--doip-tls-port must be 1..{LARGEST_PORT}, got {port}")
    return TlsNode(certificate=certificate, key=key, port=port)


PORT: Final = 13400  # registered for DoIP, both TCP and UDP
LOOPBACK: Final = "127.0.0.1"
LOCAL_BROADCAST: Final = "127.255.255.255"
BROADCAST: Final = "255.255.255.255"
ALL_NODES: Final = "ff02::1"  # on one link; what IPv6 has in place of a broadcast
BACKLOG: Final = 16
SEND_BYTES: Final = 1 << 16  # that one tester may leave unread before nothing more is read from it

Address = IPv4Address | IPv6Address


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where to listen, and what people call it."""

    host: str
    port: int
    tls: TlsNode | None = None  # likewise by TLS, on a port of its own

    def __str__(self) -> str:
        return f"{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Listening:
    """Open sockets of one address."""

    tcp: socket.socket
    tls: socket.socket | None
    udp: tuple[socket.socket, ...]  # the first one also says what is said
    everybody: tuple[str, int]  # who hears announcements
    is_exposed: bool  # whether others than this machine can reach it

    def close(self) -> None:
        for one in (self.tcp, *([] if self.tls is None else [self.tls]), *self.udp):
            one.close()


def parse_place(text: str) -> Place:
    """Return what ``[HOST:]PORT`` says; without a host this machine alone is meant. IPv6 stands in brackets.

    Raises ConfigError if it says no such thing.
    """
    host, _, port = text.rpartition(":")
    is_bracketed = host.startswith("[") and host.endswith("]")
    is_port = port.isascii() and port.isdecimal() and 1 <= int(port) <= LARGEST_PORT
    if not is_port or text.startswith(":") or (":" in host and not is_bracketed):
        raise ConfigError(f"--doip must be [HOST:]PORT with a port of 1..{LARGEST_PORT}, got {text}")
    return Place(host=(host[1:-1] if is_bracketed else host) or LOOPBACK, port=int(port))


def listen(place: Place) -> Listening:
    """Return the sockets of a place; requests to everybody on its network come in as well.

    By IPv6 they come in only where all addresses are listened on (``::``). Raises BusError if it is no address of this
    machine, or somebody else listens there.
    """
    with ExitStack() as stack:
        try:
            address = _address(place.host)
            everybody = _everybody(address)
            tcp = _connections(stack, address, place.port)
            tls = None if place.tls is None else _connections(stack, address, place.tls.port)
            is_broadcast = isinstance(address, IPv4Address) and not address.is_unspecified
            hosts = [str(address), everybody] if is_broadcast else [str(address)]
            udp = tuple(_datagrams(stack, _family(address), host, place.port) for host in hosts)
        except OSError as exc:
            raise BusError(f"DoIP cannot listen on {place}: {exc.strerror or exc}") from exc
        stack.pop_all()
    return Listening(tcp=tcp, tls=tls, udp=udp, everybody=(everybody, place.port), is_exposed=not address.is_loopback)


def _address(host: str) -> Address:
    """Return the address of a host, that of IPv4 if it has both."""
    try:
        return IPv4Address(socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_STREAM)[0][4][0])
    except socket.gaierror:
        return IPv6Address(socket.getaddrinfo(host, None, socket.AF_INET6, socket.SOCK_STREAM)[0][4][0])


def _family(address: Address) -> socket.AddressFamily:
    return socket.AF_INET if isinstance(address, IPv4Address) else socket.AF_INET6


def _everybody(address: Address) -> str:
    """Return who is reached by what is said to everybody; this machine alone if nobody else can reach the address."""
    if isinstance(address, IPv4Address):
        return LOCAL_BROADCAST if address.is_loopback else BROADCAST
    return str(address) if address.is_loopback else ALL_NODES


def _connections(stack: ExitStack, address: Address, port: int) -> socket.socket:
    one = stack.enter_context(socket.socket(_family(address), socket.SOCK_STREAM))
    one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # its connections inherit that: no 40 ms each
    one.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
    one.bind((str(address), port))
    one.listen(BACKLOG)
    return one


def _datagrams(stack: ExitStack, family: socket.AddressFamily, host: str, port: int) -> socket.socket:
    one = stack.enter_context(socket.socket(family, socket.SOCK_DGRAM))
    one.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    one.setblocking(False)
    one.bind((host, port))
    return one
