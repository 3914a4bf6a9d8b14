"""The sockets of an entity: one for connections, those for datagrams, and where announcements go."""

import socket
from contextlib import ExitStack
from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import Final

from ecu_emulator.errors import BusError, ConfigError

PORT: Final = 13400  # registered for DoIP, both TCP and UDP
LOOPBACK: Final = "127.0.0.1"
LOCAL_BROADCAST: Final = "127.255.255.255"
BROADCAST: Final = "255.255.255.255"
BACKLOG: Final = 16
LARGEST_PORT: Final = 65535
SEND_BYTES: Final = 1 << 16  # that one tester may leave unread before nothing more is read from it


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where to listen, and what people call it."""

    host: str
    port: int

    def __str__(self) -> str:
        """Return it as on the command line."""
        return f"{self.host}:{self.port}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Listening:
    """Open sockets of one address."""

    tcp: socket.socket
    udp: tuple[socket.socket, ...]  # the first one also says what is said
    everybody: tuple[str, int]  # who hears announcements
    is_exposed: bool  # whether others than this machine can reach it


def parse_place(text: str) -> Place:
    """Return what ``[HOST:]PORT`` says; without a host this machine alone is meant.

    Raises
    ------
    ConfigError
        If it says no such thing.
    """
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdecimal() and 1 <= int(port) <= LARGEST_PORT) or text.startswith(":"):
        raise ConfigError(f"--doip must be [HOST:]PORT with a port of 1..{LARGEST_PORT}, got {text}")
    return Place(host=host or LOOPBACK, port=int(port))


def listen(place: Place) -> Listening:
    """Return the sockets of a place; requests to everybody on its network come in as well.

    Raises
    ------
    BusError
        If it is no IPv4 address of this machine, or somebody else listens there.
    """
    with ExitStack() as stack:
        try:
            address = _address(place.host)
            broadcast = LOCAL_BROADCAST if address.is_loopback else BROADCAST
            tcp = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
            tcp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # its connections inherit that: no 40 ms each
            tcp.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
            tcp.bind((str(address), place.port))
            tcp.listen(BACKLOG)
            hosts = [str(address)] if address.is_unspecified else [str(address), broadcast]
            udp = tuple(stack.enter_context(_datagrams(host, place.port)) for host in hosts)
        except OSError as exc:
            raise BusError(f"DoIP cannot listen on {place}: {exc.strerror or exc}") from exc
        stack.pop_all()
    return Listening(tcp=tcp, udp=udp, everybody=(broadcast, place.port), is_exposed=not address.is_loopback)


def _address(host: str) -> IPv4Address:
    found = socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_STREAM)
    return IPv4Address(found[0][4][0])


def _datagrams(host: str, port: int) -> socket.socket:
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        one.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        one.setblocking(False)
        one.bind((host, port))
    except OSError:
        one.close()
        raise
    return one
