"""Buses of python-can by their names, and multicast UDP of ours, which keeps to this machine unless told otherwise."""

import select
import socket
import struct
import time
from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final

import can
from can.interfaces.udp_multicast.utils import pack_message, unpack_message

from canlog.live.socketcan import SO_TIMESTAMPNS, grow_receive_buffer

UDP_MULTICAST: Final = "udp_multicast"
DEFAULT_GROUP: Final = "ff15:7079:7468:6f6e:6465:6d6f:6d63:6173"  # group and port are python-can's own
DEFAULT_PORT: Final = 43113
THIS_MACHINE: Final = 0  # hops
MAX_HOPS: Final = 255
LOOPBACK: Final = "127.0.0.1"
MAX_DATAGRAM_BYTES: Final = 4096
TIMESPEC: Final = struct.Struct("@ll")
ANCILLARY_BYTES: Final = socket.CMSG_SPACE(TIMESPEC.size)
NS_PER_S: Final = 1e9
_HANDLED: Final = frozenset({"interface", "channel"})
NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})

SocketAddress = tuple[Any, ...]  # host and port, and two numbers more with IPv6


def open_bus(
    interface: str | None,
    channel: str | None,
    bitrate: int | None,
    *,
    fd: bool = False,
    options: Mapping[str, Any] = NOTHING,
) -> can.BusABC:
    """Open a bus; what is not given comes from CAN_INTERFACE, CAN_CHANNEL, CAN_CONFIG and can.conf.

    ``options`` are further arguments of the driver, such as the port of a multicast bus.

    The interface ``udp_multicast`` keeps to this machine unless the configuration names a ``hop_limit``. No bus hears
    itself, whatever is configured.

    Raises
    ------
    can.CanError, OSError, ValueError, TypeError, ImportError, RuntimeError
        If no bus is named, or it cannot be opened.
    """
    wanted: dict[str, Any] = dict(options)
    if fd:  # otherwise the default of the driver
        wanted["fd"] = True
    if bitrate is not None:
        wanted["bitrate"] = bitrate
    named = {"interface": interface, "channel": channel}
    config = can.util.load_config(config={**{key: name for key, name in named.items() if name}, **wanted})
    if config["interface"] == UDP_MULTICAST:
        options = {key: value for key, value in config.items() if key not in _HANDLED}
        if type(options.get("hop_limit", 0)) is not int:  # nor a bool, which is an int
            raise TypeError(f"hop_limit must be a whole number, got {options['hop_limit']!r}")
        return MulticastBus(str(config.get("channel") or DEFAULT_GROUP), **options)
    if config.get("receive_own_messages"):
        wanted["receive_own_messages"] = False
    return can.Bus(channel, interface, **wanted)


class MulticastBus(can.BusABC):
    """Every program on the same group and port hears what the others send, and not itself.

    With no hop, which is the default, frames neither leave this machine nor are taken from another one; an IPv4 group
    is then joined on the loopback interface, so the network does not even learn of it. With one hop or more the bus is
    that of the local network, or farther. Programs that use python-can's ``udp_multicast`` meet this bus, whose
    arguments are the same; ``hop_limit`` is how many networks a frame may cross.

    Raises can.CanInitializationError if the group cannot be joined, ValueError if it or the number of hops is none.
    """

    def __init__(
        self,
        channel: str = DEFAULT_GROUP,
        port: int = DEFAULT_PORT,
        hop_limit: int = THIS_MACHINE,
        *,
        fd: bool = True,
        **others: Any,  # noqa: ANN401 - python-can's signature
    ) -> None:
        if not 0 <= hop_limit <= MAX_HOPS:
            raise ValueError(f"hop_limit must be 0..{MAX_HOPS}, got {hop_limit}")
        self._is_local = hop_limit == THIS_MACHINE
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        self._family, self._destination = _resolved(channel, port)
        self.channel_info = f"udp_multicast {channel}:{port}"
        sender = socket.socket(self._family, socket.SOCK_DGRAM)
        receiver = socket.socket(self._family, socket.SOCK_DGRAM)
        try:
            _prepare_sender(sender, hop_limit)
            _join(receiver, self._destination, is_local=self._is_local)
        except OSError as exc:
            sender.close()
            receiver.close()
            hint = " (an IPv4 group, 239.74.163.2, needs no network)" if self._family == socket.AF_INET6 else ""
            raise can.CanInitializationError(f"group {channel} cannot be joined: {exc.strerror}{hint}") from None
        self._sender, self._receiver = sender, receiver
        self._own_port: int = sender.getsockname()[1]
        super().__init__(channel, **others)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - UDP does not wait
        """Send one frame to every program on the group.

        Raises
        ------
        can.CanOperationError
            If the frame is one of CAN FD and the bus is not, or the system refuses it.
        """
        if msg.is_fd and self._can_protocol is not can.CanProtocol.CAN_FD:
            raise can.CanOperationError("a frame of CAN FD does not fit a classic bus")
        try:
            self._sender.sendto(pack_message(msg), self._destination)
        except OSError as exc:
            raise can.CanOperationError(f"cannot send: {exc.strerror}", exc.errno) from exc

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        deadline_s = None if timeout is None else time.monotonic() + timeout
        while True:
            try:
                data, ancillary, _, origin = self._receiver.recvmsg(
                    MAX_DATAGRAM_BYTES, ANCILLARY_BYTES, socket.MSG_DONTWAIT
                )
            except BlockingIOError:
                left_s = None if deadline_s is None else deadline_s - time.monotonic()
                if left_s is not None and left_s <= 0.0:
                    return None, False
                select.select([self._receiver], [], [], left_s)
                continue
            except OSError as exc:
                raise can.CanOperationError(f"cannot receive: {exc.strerror}", exc.errno) from exc
            if self._is_heard(origin) and (message := self._message(data, ancillary)) is not None:
                return message, False

    def _is_heard(self, origin: SocketAddress) -> bool:
        if not is_own_address(self._family, (origin[0], 0, *origin[2:])):
            return not self._is_local
        return bool(origin[1] != self._own_port)

    def _message(self, data: bytes, ancillary: list[tuple[int, int, bytes]]) -> can.Message | None:
        try:
            message = unpack_message(data, replace={"timestamp": _time_s(ancillary)}, check=True)
        except Exception as exc:  # python-can promises no kind of error here
            raise can.CanOperationError("received something that is not a message of python-can") from exc
        is_wanted = self._can_protocol is can.CanProtocol.CAN_FD or not message.is_fd
        return message if is_wanted else None

    def fileno(self) -> int:
        return self._receiver.fileno()

    def shutdown(self) -> None:
        """Leave the group; a second call does nothing."""
        super().shutdown()
        self._sender.close()
        self._receiver.close()


@lru_cache(maxsize=64)
def is_own_address(family: socket.AddressFamily, address: SocketAddress) -> bool:
    """Return whether an address is one of this machine: one that a socket can be bound to, whatever port is free.

    The kernel drops what comes from outside and pretends to come from here.
    """
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(address)
        except OSError:
            return False
    return True


def _resolved(group: str, port: int) -> tuple[socket.AddressFamily, SocketAddress]:
    try:
        addresses = socket.getaddrinfo(group, port, type=socket.SOCK_DGRAM, flags=socket.AI_NUMERICHOST)
        family, address = addresses[0][0], addresses[0][4]
        digits = socket.inet_pton(family, str(address[0]).partition("%")[0])
    except (OSError, UnicodeError):
        raise ValueError(f"{group} is not a multicast address") from None
    is_multicast = digits[0] == 0xFF if family == socket.AF_INET6 else 224 <= digits[0] <= 239
    if not is_multicast:
        raise ValueError(f"{group} is not a multicast address")
    return family, address


def _prepare_sender(sender: socket.socket, hops: int) -> None:
    """Give the sender a port of its own, by which it knows its own frames, and a limit of hops."""
    sender.bind(("", 0))
    if sender.family == socket.AF_INET6:
        # The loopback interface has no route for IPv6 groups: only the limit keeps the frames in this machine.
        sender.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, hops)
        return
    sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, hops)
    if hops == THIS_MACHINE:
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(LOOPBACK))


def _join(receiver: socket.socket, group: SocketAddress, *, is_local: bool) -> None:
    """Listen to one group and port, beside others who do."""
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    receiver.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    grow_receive_buffer(receiver)
    receiver.bind(group)  # not to any address: a datagram to this machine alone is not on the bus
    packed = socket.inet_pton(receiver.family, str(group[0]).partition("%")[0])
    if receiver.family == socket.AF_INET6:
        receiver.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, packed + struct.pack("@I", group[3]))
        return
    interface = LOOPBACK if is_local else "0.0.0.0"  # noqa: S104 - a choice of interface, not an address to bind
    receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, packed + socket.inet_aton(interface))


def _time_s(ancillary: list[tuple[int, int, bytes]]) -> float:
    """Return the kernel's receive time [s], or now without one."""
    for level, kind, content in ancillary:
        if (level, kind) == (socket.SOL_SOCKET, SO_TIMESTAMPNS):
            seconds, nanoseconds = TIMESPEC.unpack(content)
            return float(seconds + nanoseconds / NS_PER_S)
    return time.time()
