"""Random captures of SocketCAN, written after the specifications of pcap and pcapng and the headers of Linux."""

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from tests.support.log_grammars import START_S, Frame, Grammar

SOCKETCAN, COOKED, COOKED_2, ETHERNET = 227, 113, 276, 1
Packet = Callable[[Frame, str], bytes]


def socketcan(frame: Frame, order: str = ">") -> bytes:
    """Return a frame as the kernel hands it to a raw socket, its identifier in this byte order."""
    can_id = frame.can_id | frame.is_extended << 31 | frame.is_remote << 30
    if frame.is_error:
        can_id = 1 << 29
    flags = (4 | frame.is_fast | frame.is_passive << 1) if frame.is_fd else 0
    head = struct.pack(f"{order}LBBBB", can_id, frame.length, flags, 0, 0)
    return head + frame.data.ljust(64 if frame.is_fd else 8, b"\0")


def cooked(frame: Frame, order: str) -> bytes:
    kind = 4 if frame.is_sent else 1
    protocol = 0xD if frame.is_fd else 0xC
    return struct.pack(">HHH8xH", kind, 280, 0, protocol) + socketcan(frame, order)


def cooked_2(frame: Frame, order: str) -> bytes:
    kind, protocol = (4 if frame.is_sent else 1), (0xD if frame.is_fd else 0xC)
    return struct.pack(">HHLHBB8x", protocol, 0, frame.channel, 280, kind, 0) + socketcan(frame, order)


def trimmed(frame: Frame, _order: str) -> bytes:
    """Return a frame without the bytes that it does not use, as converters write it."""
    return socketcan(frame)[: 8 + len(frame.data)]


PACKETS: Mapping[int, Packet] = MappingProxyType(
    {SOCKETCAN: lambda frame, _: socketcan(frame), COOKED: cooked, COOKED_2: cooked_2}
)


def pcap(
    link: int, order: str = "<", parts: int = 1_000_000, packet: Packet | None = None
) -> Callable[[Path, Sequence[Frame]], None]:
    made = packet or PACKETS[link]

    def write(path: Path, frames: Sequence[Frame]) -> None:
        magic = 0xA1B2C3D4 if parts == 1_000_000 else 0xA1B23C4D
        pieces = [struct.pack(f"{order}LHHLLLL", magic, 2, 4, 0, 0, 262144, link)]
        for frame in frames:
            data, (seconds, part_us) = made(frame, order), divmod(frame.t_us, 1_000_000)
            sizes = len(data), len(data)
            pieces += [struct.pack(f"{order}LLLL", START_S + seconds, part_us * parts // 1_000_000, *sizes), data]
        path.write_bytes(b"".join(pieces))

    return write


def block(order: str, kind: int, body: bytes) -> bytes:
    size = 12 + len(body) + -len(body) % 4
    return struct.pack(f"{order}LL", kind, size) + body + bytes(-len(body) % 4) + struct.pack(f"{order}L", size)


def option(order: str, code: int, value: bytes) -> bytes:
    return struct.pack(f"{order}HH", code, len(value)) + value + bytes(-len(value) % 4)


def pcapng(
    link: int,
    order: str = "<",
    resolution: int = 6,
    offset_s: int = 0,
    *,
    has_others: bool = False,
    packet: Packet | None = None,
) -> Callable[[Path, Sequence[Frame]], None]:
    """Return the writer of a capture with ten interfaces, can0 to can9; with others there are blocks of other kinds."""
    ticks = 2 ** (resolution & 0x7F) if resolution & 0x80 else 10**resolution
    made = packet or PACKETS[link]

    def write(path: Path, frames: Sequence[Frame]) -> None:
        section = struct.pack(f"{order}LHHq", 0x1A2B3C4D, 1, 0, -1)
        pieces = [block(order, 0x0A0D0D0A, section)]
        for number in range(10):
            options = option(order, 2, b"can%d" % number) + option(order, 9, bytes([resolution]))
            options += option(order, 14, struct.pack(f"{order}q", offset_s)) + option(order, 0, b"")
            pieces.append(block(order, 1, struct.pack(f"{order}HHL", link, 0, 0) + options))
        if has_others:
            pieces.append(block(order, 1, struct.pack(f"{order}HHL", ETHERNET, 0, 0)))
        for frame in frames:
            if has_others:
                pieces.append(block(order, 4, bytes(4)) + block(order, 5, bytes(12)))
                pieces.append(block(order, 6, struct.pack(f"{order}LLLLL", 10, 0, 5, 60, 60) + bytes(60)))
            data = made(frame, order)
            since_us = (START_S - offset_s) * 1_000_000 + frame.t_us
            at = -(-since_us * ticks // 1_000_000)
            head = struct.pack(f"{order}LLLLL", frame.channel, at >> 32, at & 0xFFFFFFFF, len(data), len(data))
            pieces.append(block(order, 6, head + data + bytes(-len(data) % 4) + option(order, 2, bytes(4))))
        path.write_bytes(b"".join(pieces))

    return write


ALONE = Grammar(write=pcap(SOCKETCAN), has_fd=True, has_direction=False, is_text=False)
TOGETHER = replace(ALONE, write=pcapng(SOCKETCAN), channels=10)
SENT = {"has_direction": True, "has_direction_of_errors": True}
CAPTURE_GRAMMARS: Mapping[str, Grammar] = MappingProxyType({
    "pcap": ALONE,
    "pcap big-endian in nanoseconds": replace(ALONE, write=pcap(SOCKETCAN, ">", 1_000_000_000)),
    "pcap of trimmed frames": replace(ALONE, write=pcap(SOCKETCAN, packet=trimmed)),
    "pcap cooked": replace(ALONE, write=pcap(COOKED), **SENT),
    "pcap cooked, big-endian": replace(ALONE, write=pcap(COOKED, ">"), **SENT),
    "pcap cooked, version 2": replace(TOGETHER, write=pcap(COOKED_2, parts=1_000_000_000), **SENT),
    "pcapng": TOGETHER,
    "pcapng big-endian in nanoseconds": replace(TOGETHER, write=pcapng(SOCKETCAN, ">", 9, has_others=True)),
    "pcapng in parts of a power of two": replace(TOGETHER, write=pcapng(SOCKETCAN, "<", 0x80 | 30, 1_000_000_000)),
    "pcapng cooked": replace(TOGETHER, write=pcapng(COOKED, "<", 9), **SENT),
})  # fmt: skip
