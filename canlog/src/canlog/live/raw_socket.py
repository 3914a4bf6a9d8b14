"""A network interface of SocketCAN: raw sockets, what their errors mean, its name now, a restart of its controller."""

import errno
import os
import socket
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from canlog.errors import SourceError

RECEIVE_BUFFER_BYTES = 8 * 1024 * 1024  # about ten thousand frames: some seconds of a full bus
SO_RCVBUFFORCE = 33  # linux/socket.h
SO_TIMESTAMPNS = 35
ALL_ERROR_CLASSES = 0x1FFF_FFFF
CAN_RAW_ERR_FILTER = 2
SO_MEMINFO = 55
MEMINFO_FORMAT = "9I"
MEMINFO_DROPS = 8  # index of SK_MEMINFO_DROPS


def open_socket(
    channel: str, *, fd: bool, receive_buffer_bytes: int, filters: Sequence[tuple[int, int]] = ()
) -> socket.socket:
    """Return a raw CAN socket, bound, stamping and non-blocking.

    Raises SourceError if this kernel has no CAN, or the interface is not there, not CAN, or down.
    """
    try:
        raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW | socket.SOCK_NONBLOCK, socket.CAN_RAW)
    except OSError as exc:
        raise opening_failed(channel, exc) from exc
    try:
        raw.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        raw.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, ALL_ERROR_CLASSES)
        if filters:
            packed = b"".join(struct.pack("=II", *one) for one in filters)
            raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, packed)
        if fd:
            raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        grow_receive_buffer(raw, receive_buffer_bytes)
        raw.bind((channel,))
        if failure := raw.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):  # an interface that is down says so here
            raise OSError(failure, os.strerror(failure))  # noqa: TRY301 - one place translates every failure
    except OSError as exc:
        raw.close()
        raise opening_failed(channel, exc) from exc
    return raw


def grow_receive_buffer(opened: socket.socket, size_bytes: int = RECEIVE_BUFFER_BYTES) -> None:
    """Set the receive buffer's size, past the limit of the system if we may; its default loses frames in silence."""
    try:
        opened.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, size_bytes)
    except OSError:  # not ours to force, or another system
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size_bytes)


def let_nothing_in(raw: socket.socket) -> None:
    """Have the kernel give this socket no more frames; those that it holds can still be read."""
    raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
    raw.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, 0)


def granted_share(raw: socket.socket) -> float:
    """Return how much of the receive buffer that the schedule counts on the system has granted."""
    granted_bytes = raw.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2  # it tells twice what was asked for
    return min(1.0, granted_bytes / RECEIVE_BUFFER_BYTES)


def kernel_drops(raw: socket.socket) -> int:
    """Return how many frames the kernel could not put into this socket's receive buffer."""
    memory = raw.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, struct.calcsize(MEMINFO_FORMAT))
    return int(struct.unpack(MEMINFO_FORMAT, memory)[MEMINFO_DROPS])


def opening_failed(channel: str, error: OSError) -> SourceError:
    """Say why an interface cannot be opened and what to do about it."""
    match error.errno:
        case errno.EAFNOSUPPORT | errno.EPROTONOSUPPORT:
            return SourceError(
                "this kernel has no CAN sockets (modprobe can-raw), or use another interface: "
                "-i udp_multicast -c 239.74.163.2"
            )
        case errno.ENODEV if not os.path.exists(f"/sys/class/net/{channel}"):  # noqa: PTH110 - a name, not a path
            return SourceError(
                f"no CAN interface {channel!r}: create it (ip link add {channel} type vcan; ip link set {channel} up)"
            )
        case errno.ENODEV:
            return SourceError(f"{channel!r} is not a CAN interface: `ip link show type can` and `type vcan` list them")
        case errno.ENETDOWN:
            return SourceError(f"CAN interface {channel!r} is down: switch it on (ip link set {channel} up)")
        case _:
            return SourceError(f"CAN interface {channel!r} cannot be opened: {error.strerror or error}")


def reading_failed(channel: str, error: OSError) -> SourceError:
    """Say why an interface that was open can no longer be read."""
    match error.errno:
        case errno.ENETDOWN:
            return SourceError(f"CAN interface {channel!r} went down: switch it on (ip link set {channel} up)")
        case errno.ENODEV:
            return SourceError(f"CAN interface {channel!r} was removed")
        case _:
            return SourceError(f"CAN interface {channel!r} cannot be read: {error.strerror or error}")


_RTM_NEWLINK = 16
_NLMSG_ERROR = 2
_REQUEST_WITH_ANSWER = 0x1 | 0x4  # NLM_F_REQUEST, NLM_F_ACK
_NESTED = 0x8000
_IFLA_LINKINFO, _INFO_KIND, _INFO_DATA, _CAN_RESTART = 18, 1, 2, 7
_HEADER = struct.Struct("=IHHII")
_INTERFACE = struct.Struct("=BxHiII")
_ANSWER_BYTES = 4096
_ANSWER_S = 0.5


def index_of(name: str) -> int | None:
    """Return the kernel's number of an interface, None if there is none of that name."""
    try:
        return socket.if_nametoindex(name)
    except OSError:
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """An interface as it was when it was last opened."""

    name: str
    index: int | None


def present_name(name: str, last: Seen | None) -> str:
    """Return the name under which an interface called ``name`` is to be looked for now.

    The name counts. Only if nobody has it any more, the interface last opened is followed: by its number, which it
    keeps when it is renamed, else by the name it had, under which it may be made again.
    """
    if last is None or last.index is None or index_of(name) is not None:
        return name
    try:
        return socket.if_indextoname(last.index)
    except OSError:
        return last.name


def restart_controller(name: str) -> str | None:
    """Ask the kernel to restart a CAN controller that is bus-off; return why it will not, None if it does.

    The kernel permits this to the administrator of the network only, for hardware only, and not where it restarts
    controllers by itself (restart-ms).
    """
    index = index_of(name)
    if index is None:
        return os.strerror(errno.ENODEV)
    info = _attribute(_INFO_KIND, b"can\0") + _attribute(
        _INFO_DATA | _NESTED, _attribute(_CAN_RESTART, struct.pack("=I", 1))
    )
    body = _INTERFACE.pack(socket.AF_UNSPEC, 0, index, 0, 0) + _attribute(_IFLA_LINKINFO | _NESTED, info)
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as netlink:
            netlink.settimeout(_ANSWER_S)
            netlink.bind((0, 0))
            netlink.send(_HEADER.pack(_HEADER.size + len(body), _RTM_NEWLINK, _REQUEST_WITH_ANSWER, 1, 0) + body)
            answer = netlink.recv(_ANSWER_BYTES)
    except OSError as exc:
        return exc.strerror or str(exc)
    kind, code = _HEADER.unpack_from(answer)[1], struct.unpack_from("=i", answer, _HEADER.size)[0]
    return None if kind == _NLMSG_ERROR and code == 0 else os.strerror(-code)


def _attribute(kind: int, value: bytes) -> bytes:
    """Return one netlink attribute, padded to four bytes."""
    return struct.pack("=HH", 4 + len(value), kind) + value + b"\0" * (-len(value) % 4)
