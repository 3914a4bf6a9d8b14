"""Captures of SocketCAN by tcpdump, Wireshark and others: pcap and pcapng, in either byte order.

Read are packets of CAN, and what the ``any`` device of Linux caught of it (cooked captures, version 1 and 2); packets
of other links are skipped. An identifier stands in network byte order, in cooked captures in that of the file; where
most identifiers can only stand in the other one, as some writers leave them, all are swapped, and that is said.
"""

import os
import re
import struct
from collections.abc import Iterator
from typing import BinaryIO, Final

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.errors import SourceError
from canlog.frames import (
    BRS_FLAG,
    ERROR_FLAG,
    ESI_FLAG,
    EXTENDED_FLAG,
    FD_FLAG,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    TX_FLAG,
    FrameBatch,
)
from canlog.jit import kernel, part
from canlog.logs import text_kernels as outcomes
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.text_kernels import FrameBuffer, FrameRows, lower, reversed_bytes

# What has been done, and how it goes on.
POSITION, ROWS, PACKETS, SKIPPED, MALFORMED, FIRST_MALFORMED, DAMAGED, FIRST_DAMAGED = range(8)
IS_LOST, TOO_WIDE, BLOCK, IS_BIG, IS_BLOCKS, INTERFACES, LAST_S = range(8, 15)
IS_SWAPPED, ODD, ODD_SWAPPED, REPORT_FIELDS = range(15, 19)  # identifiers that cannot be, in either order
# What is known of an interface: its kind of link, ticks a second, what is to be added to its times, its number.
LINK, TICKS, OFFSET_S, CHANNEL, INTERFACE_FIELDS = range(5)

SOCKETCAN, COOKED, COOKED_2 = LINKS = 227, 113, 276
# Where a cooked header has hardware, protocol, whether the packet was sent; its length.
COOKED_OFFSETS, COOKED_2_PLACES, COOKED_2_INTERFACE = (2, 14, 1, 16), (8, 0, 10, 20), 4
CAN_HARDWARE, FD_PROTOCOL, XL_PROTOCOL, OUTGOING = 280, 0x000D, 0x000E, 4  # of if_arp.h and if_ether.h
SECTION_HEADER, INTERFACE, SIMPLE_PACKET, PACKET = 0x0A0D_0D0A, 1, 3, 6
HEADER_BYTES, PACKET_BYTES, LEAST_BLOCK_BYTES = 16, 28, 12  # of a packet in pcap; in pcapng up to its data
LEAST_RECORD_BYTES = 24  # with the header of a frame
FRAME_HEADER_BYTES, FD_FRAME_BYTES = 8, 72
LONGEST_PACKET, LONGEST_FRAME_PACKET, LONGEST_BLOCK = 262_144, 92, 16 * 1024 * 1024
MOST_STEP_S = 86_400  # from packet to packet, where the place of a packet has to be guessed
LAST_TIME_S = 9_200_000_000
NS_PER_US, NS_PER_S = 1_000, 1_000_000_000
FD_BIT, BRS_BIT, ESI_BIT, XL_BIT = 0x04, 0x01, 0x02, 0x80  # of a frame's flags; the last one of its length
STANDARD_ID, EXTENDED_ID, LAST_CLASS = 0x7FF, 0x1FFF_FFFF, 0xFFF  # the last one of errors


@kernel
def parse_records(
    raw: UInt8Array,
    interfaces: Int64Array,
    rows: FrameRows,
    report: Int64Array,
    goes_on: bool,  # noqa: FBT001 - of a kernel
) -> None:
    """Go through the records of a buffer, up to the first that it does not hold whole, or that tells of the others.

    Where a record cannot be, the next place where one can be is looked for; that is counted as damage.
    """
    at = report[POSITION]
    report[TOO_WIDE] = report[BLOCK] = 0
    while True:
        size = _record_bytes(raw, at, interfaces, report)
        if size < 0:
            report[FIRST_DAMAGED] = report[FIRST_DAMAGED] if report[DAMAGED] else report[PACKETS] + 1
            report[DAMAGED] += not report[IS_LOST]
            report[IS_LOST] = 1
            at += 1
            continue
        if size == 0 or at + size > raw.size:
            at = raw.size if report[IS_LOST] and not goes_on else at  # nothing more to be found
            break
        report[IS_LOST] = 0
        kind = _long(raw, at, report[IS_BIG]) if report[IS_BLOCKS] else PACKET
        if kind == INTERFACE or kind == SECTION_HEADER:  # noqa: PLR1714, SIM109 - no tuple in a kernel
            report[BLOCK] = 1
            break
        outcome = outcomes.MALFORMED if kind == SIMPLE_PACKET else outcomes.SKIPPED  # that has no time
        if kind == PACKET:
            outcome = _packet(raw, at, size, interfaces, rows, report)
        if outcome == outcomes.TOO_LONG:
            report[TOO_WIDE] = 1
            break
        report[PACKETS] += 1
        report[ROWS] += outcome == outcomes.FRAME
        report[SKIPPED] += outcome == outcomes.SKIPPED
        if outcome == outcomes.MALFORMED:
            report[FIRST_MALFORMED] = report[FIRST_MALFORMED] if report[MALFORMED] else report[PACKETS]
            report[MALFORMED] += 1
        at += size
    report[POSITION] = at


@part
def _long(raw: UInt8Array, at: int, is_big: int) -> int:
    value = lower(raw, at)
    return reversed_bytes(value) if is_big else value


@part
def _short(raw: UInt8Array, at: int) -> int:
    """Return two bytes in network byte order."""
    return int(raw[at]) << 8 | int(raw[at + 1])


@part
def _record_bytes(raw: UInt8Array, at: int, interfaces: Int64Array, report: Int64Array) -> int:
    """Return how long a record is, 0 if the buffer does not tell, -1 if there can be none."""
    is_big, is_lost = report[IS_BIG], report[IS_LOST] != 0
    if at + (LEAST_BLOCK_BYTES if report[IS_BLOCKS] else HEADER_BYTES) > raw.size:
        return 0
    if not report[IS_BLOCKS]:
        seconds, part, size = _long(raw, at, is_big), _long(raw, at + 4, is_big), _long(raw, at + 8, is_big)
        is_sound = size <= LONGEST_PACKET and part < interfaces[0, TICKS]
        if is_lost:
            is_sound = is_sound and FRAME_HEADER_BYTES <= size <= LONGEST_FRAME_PACKET
            is_sound = is_sound and size == _long(raw, at + 12, is_big)
            is_sound = is_sound and abs(seconds - report[LAST_S]) <= MOST_STEP_S
        return HEADER_BYTES + size if is_sound else -1
    if lower(raw, at) == SECTION_HEADER:  # the same in either order; what follows says which it is
        is_big = int(raw[at + 8] == 0x1A)
    kind, size = _long(raw, at, is_big), _long(raw, at + 4, is_big)
    least_bytes = PACKET_BYTES + 4 if kind == PACKET else LEAST_BLOCK_BYTES
    is_sound = size % 4 == 0 and least_bytes <= size <= LONGEST_BLOCK
    is_known = 0 < kind <= PACKET or kind == SECTION_HEADER
    if not is_sound or (is_lost and (size > LONGEST_PACKET or not is_known)):
        return -1
    return size if at + size > raw.size or _long(raw, at + size - 4, is_big) == size else -1


@part
def _packet(  # noqa: PLR0911 - one for each reason
    raw: UInt8Array, at: int, size: int, interfaces: Int64Array, rows: FrameRows, report: Int64Array
) -> int:
    """Write the frame of a packet into a row; return FRAME, or what else it is."""
    is_big, number = report[IS_BIG], 0
    if report[IS_BLOCKS]:
        number, length = _long(raw, at + 8, is_big), _long(raw, at + 20, is_big)
        if number >= report[INTERFACES] or length > size - PACKET_BYTES - 4:
            return outcomes.MALFORMED
        ticks = _long(raw, at + 12, is_big) << 32 | _long(raw, at + 16, is_big)
        seconds, part = ticks // interfaces[number, TICKS], ticks % interfaces[number, TICKS]
        at += PACKET_BYTES
    else:
        seconds, part, length = _long(raw, at, is_big), _long(raw, at + 4, is_big), size - HEADER_BYTES
        at += HEADER_BYTES
    seconds += interfaces[number, OFFSET_S]
    if not 0 <= seconds < LAST_TIME_S:
        return outcomes.MALFORMED
    report[LAST_S], row = seconds, report[ROWS]
    time_ns = seconds * NS_PER_S + part * NS_PER_S // interfaces[number, TICKS]
    rows.t_ns[row] = (time_ns + NS_PER_US // 2) // NS_PER_US * NS_PER_US
    rows.channel[row], rows.flags[row] = interfaces[number, CHANNEL], 0
    if interfaces[number, LINK] == SOCKETCAN:
        return _frame(raw, at, length, rows, row, 0, 1, report)
    if interfaces[number, LINK] == COOKED_2 and length >= HEADER_BYTES:
        rows.channel[row] = min(_long(raw, at + COOKED_2_INTERFACE, 1), 255)
    elif interfaces[number, LINK] != COOKED:
        return outcomes.SKIPPED
    hardware, protocol, sent, header = COOKED_OFFSETS if interfaces[number, LINK] == COOKED else COOKED_2_PLACES
    if length < header:
        return outcomes.MALFORMED
    if _short(raw, at + hardware) != CAN_HARDWARE:
        return outcomes.SKIPPED
    rows.flags[row] = TX_FLAG * (raw[at + sent] == OUTGOING)
    return _frame(raw, at + header, length - header, rows, row, _short(raw, at + protocol), is_big, report)


@part
def _is_odd(said: int) -> bool:
    """Return whether nobody numbers a frame so: too large, an error of no class, 29 bits that end with 16 zeros."""
    if said & ERROR_FLAG:
        return bool(said & ~ERROR_FLAG > LAST_CLASS)
    return bool(said & 0xFFFF == 0 if said & EXTENDED_FLAG else said & ~REMOTE_FLAG > STANDARD_ID)


@part
def _frame(
    raw: UInt8Array, at: int, size: int, rows: FrameRows, row: int, protocol: int, is_big: int, report: Int64Array
) -> int:
    """Write a frame as SocketCAN has them into a row; return as ``_packet``."""
    if size < FRAME_HEADER_BYTES or protocol == XL_PROTOCOL or raw[at + 4] & XL_BIT:
        return outcomes.MALFORMED
    said, other = _long(raw, at, is_big != report[IS_SWAPPED]), _long(raw, at, is_big == report[IS_SWAPPED])
    count, bits = int(raw[at + 4]), int(raw[at + 5])
    report[ODD] += _is_odd(said)
    report[ODD_SWAPPED] += _is_odd(other)
    is_remote = said & (REMOTE_FLAG | ERROR_FLAG) == REMOTE_FLAG
    is_fd = protocol == FD_PROTOCOL or bits & FD_BIT != 0 or size == FD_FRAME_BYTES or count > PAYLOAD_BYTES
    can_id = said & ~REMOTE_FLAG
    if said & ERROR_FLAG:
        can_id = said & EXTENDED_ID | ERROR_FLAG
    elif not said & EXTENDED_FLAG and can_id > STANDARD_ID:
        return outcomes.MALFORMED
    stored = 0 if is_remote else count
    if (is_fd and said & (REMOTE_FLAG | ERROR_FLAG)) or size < FRAME_HEADER_BYTES + stored:
        return outcomes.MALFORMED
    if count >= len(outcomes.IS_LENGTH) or not outcomes.IS_LENGTH[count]:
        return outcomes.MALFORMED
    if count > rows.data.shape[1]:
        return outcomes.TOO_LONG
    if is_fd:
        rows.flags[row] |= FD_FLAG | (BRS_FLAG if bits & BRS_BIT else 0) | (ESI_FLAG if bits & ESI_BIT else 0)
    rows.can_id[row], rows.length[row] = np.uint32(can_id | (REMOTE_FLAG if is_remote else 0)), count
    for index in range(rows.data.shape[1]):
        rows.data[row, index] = raw[at + FRAME_HEADER_BYTES + index] if index < stored else 0
    return outcomes.FRAME


MAGICS: Final = {
    struct.pack(order + "L", magic): (order, ticks)
    for order in "<>"
    for magic, ticks in ((0xA1B2C3D4, 1_000_000), (0xA1B23C4D, 1_000_000_000))
}  # the byte order of the file, and into how many parts seconds are divided
SECTION_MAGIC: Final = SECTION_HEADER.to_bytes(4, "big")
CAPTURE_MAGICS: Final = (*MAGICS, SECTION_MAGIC)
BIG_ORDER_MAGIC: Final = bytes.fromhex("1A2B3C4D")
FILE_HEADER, FILE_HEADER_BYTES = "4s16xL", 24  # of pcap
LINK_MASK: Final = 0x0FFF_FFFF  # above it stands how long checksums are
PIECE_BYTES: Final = 1024 * 1024
MOST_INTERFACES, MOST_CHANNEL = 256, 255
MOST_TICKS: Final = 9_000_000_000  # a second's, from which nanoseconds can be told
NAME_OPTION, RESOLUTION_OPTION, OFFSET_OPTION = 2, 9, 14
LEAST_PACKETS: Final = 10  # that tell a byte order
MOST_ODD: Final = 0.1  # of packets whose identifiers stand in the right byte order
SWAPPED: Final = "the identifiers stand in the other byte order than this kind of capture has: they are read swapped"
DIGITS_AT_END: Final = re.compile(rb"(\d{1,3})\0*$")


def capture_of(probe: bytes) -> str:
    """Return what a capture that begins so is, ``pcap`` or ``pcapng``; raises SourceError if it has no CAN."""
    order, _ = MAGICS.get(probe[:4], ("", 0))
    if order and len(probe) >= FILE_HEADER_BYTES:
        link = struct.unpack_from(order + FILE_HEADER, probe)[1] & LINK_MASK
        if link not in LINKS:
            raise SourceError(f"a pcap capture of another kind of network than CAN (link type {link})")
    return "pcap" if order else "pcapng"


def read_capture(stream: BinaryIO, counts: LogCounts) -> Iterator[FrameBatch]:
    """Yield the frames of a capture, a batch for each MiB of it; raises SourceError if it ends inside its header."""
    size_bytes, read_bytes = stream.seek(0, os.SEEK_END), stream.seek(0)
    report, interfaces = _beginning(stream)
    frames, tail = FrameBuffer(0), b""
    while True:
        piece = stream.read(PIECE_BYTES)
        raw = np.frombuffer(tail + piece, np.uint8)
        frames.reserve(len(raw) // LEAST_RECORD_BYTES + 1, 0)
        report[[POSITION, ROWS, SKIPPED, MALFORMED, DAMAGED]] = 0
        before = report.copy()
        _parse(raw, interfaces, frames, report, goes_on=bool(piece))
        if not before[PACKETS] and _is_swapped(report):
            report[:] = before
            report[IS_SWAPPED] = 1
            _parse(raw, interfaces, frames, report, goes_on=bool(piece))
            counts.note(SWAPPED)
        tail, count = raw[report[POSITION] :].tobytes(), int(report[ROWS])
        read_bytes = stream.seek(0, os.SEEK_CUR)
        counts.skipped += int(report[SKIPPED])
        counts.reject(LogReject.DAMAGED, f"packet {report[FIRST_DAMAGED]}", int(report[DAMAGED]))
        counts.reject(LogReject.MALFORMED, f"packet {report[FIRST_MALFORMED]}", int(report[MALFORMED]))
        if count:
            counts.frames += count
            yield frames.batch(count)
        if not piece:
            break
    if tail or read_bytes < size_bytes:
        counts.cut_off(f"byte {read_bytes - len(tail)}")


def _parse(raw: UInt8Array, interfaces: Int64Array, frames: FrameBuffer, report: Int64Array, *, goes_on: bool) -> None:
    """Go through the records of a buffer, taking up what they tell of the others."""
    while True:
        parse_records(raw, interfaces, frames.rows, report, goes_on)
        if report[TOO_WIDE]:
            frames.widen(int(report[ROWS]))
        elif report[BLOCK]:
            _read_block(raw[report[POSITION] :].tobytes(), interfaces, report)
        else:
            return


def _is_swapped(report: Int64Array) -> bool:
    """Return whether most identifiers cannot be in their byte order, and all but a few can in the other one."""
    packets = int(report[ROWS] + report[MALFORMED])
    is_odd = packets >= LEAST_PACKETS and report[ODD] > packets / 2
    return bool(is_odd and report[ODD_SWAPPED] <= MOST_ODD * packets)


def _beginning(stream: BinaryIO) -> tuple[Int64Array, Int64Array]:
    """Return what is known at the first packet: how it goes on, and of pcap the only interface."""
    report = np.zeros(REPORT_FIELDS, np.int64)
    interfaces = np.zeros((MOST_INTERFACES, INTERFACE_FIELDS), np.int64)
    header = stream.read(FILE_HEADER_BYTES)
    order, ticks = MAGICS.get(header[:4], ("", 0))
    if not order:
        stream.seek(0)
        report[IS_BLOCKS] = 1
        return report, interfaces
    if len(header) < FILE_HEADER_BYTES:
        raise SourceError("the capture ends inside its header")
    report[[IS_BIG, INTERFACES]] = order == ">", 1
    link = struct.unpack(order + FILE_HEADER, header)[1] & LINK_MASK
    interfaces[0, [LINK, TICKS]] = link, ticks
    return report, interfaces


def _read_block(block: bytes, interfaces: Int64Array, report: Int64Array) -> None:
    """Take up a section's header or the description of an interface, and go on behind it."""
    is_section = block.startswith(SECTION_MAGIC)
    if is_section:
        report[[IS_BIG, INTERFACES]] = block[8:12] == BIG_ORDER_MAGIC, 0
    order, number = ">" if report[IS_BIG] else "<", int(report[INTERFACES])
    size, link = struct.unpack_from(f"{order}4xLH", block)
    report[POSITION] += size
    if is_section or number >= MOST_INTERFACES:
        return
    options = dict(_options(block[16 : size - 4], order))
    resolution = options.get(RESOLUTION_OPTION, b"\6")[0]
    ticks = 2 ** (resolution & 0x7F) if resolution & 0x80 else 10**resolution
    name = DIGITS_AT_END.search(options.get(NAME_OPTION, b""))
    offset_s = struct.unpack_from(f"{order}q", options.get(OFFSET_OPTION, b"").ljust(8, b"\0"))[0]
    channel = min(int(name[1]) if name else number, MOST_CHANNEL)
    interfaces[number] = (link, ticks, offset_s, channel) if ticks <= MOST_TICKS else (0, 1, 0, 0)
    report[INTERFACES] += 1


def _options(block: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield the options of a block that hold something."""
    at = 0
    while at + 4 <= len(block):
        code, size = struct.unpack_from(f"{order}HH", block, at)
        if size:
            yield code, block[at + 4 : at + 4 + size]
        at += 4 + size + -size % 4
