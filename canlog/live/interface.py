"""A network interface beyond its socket: the name it has now, and a restart of its CAN controller."""

import errno
import os
import socket
import struct
from dataclasses import dataclass

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
