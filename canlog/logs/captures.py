"""Captures of SocketCAN by tcpdump, Wireshark and others: pcap and pcapng, in either byte order.

Read are packets of CAN, and what the ``any`` device of Linux caught of it (cooked captures, version 1 and 2); packets
of other links are skipped. An identifier stands in network byte order, in cooked captures in that of the file.
"""

import os
import re
import struct
from collections.abc import Iterator
from typing import BinaryIO, Final

import numpy as np

from canlog.arrays import Int64Array
from canlog.errors import SourceError
from canlog.frames import FrameBatch
from canlog.logs import captures_kernel as kernel
from canlog.logs.frame_buffer import FrameBuffer
from canlog.logs.log_counts import LogCounts, LogReject

MAGICS: Final = {
    struct.pack(order + "L", magic): (order, ticks)
    for order in "<>"
    for magic, ticks in ((0xA1B2C3D4, 1_000_000), (0xA1B23C4D, 1_000_000_000))
}  # the byte order of the file, and into how many parts seconds are divided
SECTION_MAGIC: Final = kernel.SECTION_HEADER.to_bytes(4, "big")
BIG_ORDER_MAGIC: Final = bytes.fromhex("1A2B3C4D")
HEADER, HEADER_BYTES = "4s16xL", 24  # of pcap
LINK_MASK: Final = 0x0FFF_FFFF  # above it stands how long checksums are
PIECE_BYTES: Final = 1024 * 1024
MOST_INTERFACES, MOST_CHANNEL = 256, 255
MOST_TICKS: Final = 9_000_000_000  # a second's, from which nanoseconds can be told
NAME_OPTION, RESOLUTION_OPTION, OFFSET_OPTION = 2, 9, 14
DIGITS_AT_END: Final = re.compile(rb"(\d{1,3})\0*$")


def capture_of(probe: bytes) -> str:
    """Return what a file that begins so is, ``pcap`` or ``pcapng``, or nothing; raises SourceError if it has no CAN."""
    order, _ = MAGICS.get(probe[:4], ("", 0))
    if order and len(probe) >= HEADER_BYTES:
        link = struct.unpack_from(order + HEADER, probe)[1] & LINK_MASK
        if link not in kernel.LINKS:
            raise SourceError(f"a pcap capture of another kind of network than CAN (link type {link})")
    return "pcapng" if probe.startswith(SECTION_MAGIC) else "pcap" if order else ""


def read_capture(stream: BinaryIO, counts: LogCounts) -> Iterator[FrameBatch]:
    """Yield the frames of a capture, a batch for each MiB of it; raises SourceError if it ends inside its header."""
    size_bytes, read_bytes = stream.seek(0, os.SEEK_END), stream.seek(0)
    report, interfaces = _beginning(stream)
    frames, tail = FrameBuffer(0), b""
    while True:
        piece = stream.read(PIECE_BYTES)
        raw = np.frombuffer(tail + piece, np.uint8)
        frames.reserve(len(raw) // kernel.LEAST_RECORD_BYTES + 1, 0)
        report[[kernel.POSITION, kernel.ROWS, kernel.SKIPPED, kernel.MALFORMED, kernel.DAMAGED]] = 0
        while True:
            kernel.parse_records(raw, interfaces, frames.rows, report, bool(piece))
            if report[kernel.TOO_WIDE]:
                frames.widen(int(report[kernel.ROWS]))
            elif report[kernel.BLOCK]:
                _read_block(raw[report[kernel.POSITION] :].tobytes(), interfaces, report)
            else:
                break
        tail, count = raw[report[kernel.POSITION] :].tobytes(), int(report[kernel.ROWS])
        read_bytes = stream.seek(0, os.SEEK_CUR)
        counts.skipped += int(report[kernel.SKIPPED])
        counts.reject(LogReject.DAMAGED, f"packet {report[kernel.FIRST_DAMAGED]}", int(report[kernel.DAMAGED]))
        counts.reject(LogReject.MALFORMED, f"packet {report[kernel.FIRST_MALFORMED]}", int(report[kernel.MALFORMED]))
        if count:
            counts.frames += count
            yield frames.batch(count)
        if not piece:
            break
    if tail or read_bytes < size_bytes:
        counts.cut_off(f"byte {read_bytes - len(tail)}")


def _beginning(stream: BinaryIO) -> tuple[Int64Array, Int64Array]:
    """Return what is known at the first packet: how it goes on, and of pcap the only interface."""
    report = np.zeros(kernel.REPORT_FIELDS, np.int64)
    interfaces = np.zeros((MOST_INTERFACES, kernel.INTERFACE_FIELDS), np.int64)
    header = stream.read(HEADER_BYTES)
    order, ticks = MAGICS.get(header[:4], ("", 0))
    if not order:
        stream.seek(0)
        report[kernel.IS_BLOCKS] = 1
        return report, interfaces
    if len(header) < HEADER_BYTES:
        raise SourceError("the capture ends inside its header")
    report[[kernel.IS_BIG, kernel.INTERFACES]] = order == ">", 1
    link = struct.unpack(order + HEADER, header)[1] & LINK_MASK
    interfaces[0, [kernel.LINK, kernel.TICKS]] = link, ticks
    return report, interfaces


def _read_block(block: bytes, interfaces: Int64Array, report: Int64Array) -> None:
    """Take up a section's header or the description of an interface, and go on behind it."""
    is_section = block.startswith(SECTION_MAGIC)
    if is_section:
        report[[kernel.IS_BIG, kernel.INTERFACES]] = block[8:12] == BIG_ORDER_MAGIC, 0
    order, number = ">" if report[kernel.IS_BIG] else "<", int(report[kernel.INTERFACES])
    size, link = struct.unpack_from(f"{order}4xLH", block)
    report[kernel.POSITION] += size
    if is_section or number >= MOST_INTERFACES:
        return
    options = dict(_options(block[16 : size - 4], order))
    resolution = options.get(RESOLUTION_OPTION, b"\6")[0]
    ticks = 2 ** (resolution & 0x7F) if resolution & 0x80 else 10**resolution
    name = DIGITS_AT_END.search(options.get(NAME_OPTION, b""))
    offset_s = struct.unpack_from(f"{order}q", options.get(OFFSET_OPTION, b"").ljust(8, b"\0"))[0]
    channel = min(int(name[1]) if name else number, MOST_CHANNEL)
    interfaces[number] = (link, ticks, offset_s, channel) if ticks <= MOST_TICKS else (0, 1, 0, 0)
    report[kernel.INTERFACES] += 1


def _options(block: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield the options of a block that hold something."""
    at = 0
    while at + 4 <= len(block):
        code, size = struct.unpack_from(f"{order}HH", block, at)
        if size:
            yield code, block[at + 4 : at + 4 + size]
        at += 4 + size + -size % 4
