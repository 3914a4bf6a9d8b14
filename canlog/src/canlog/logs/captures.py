"""Captures of SocketCAN by tcpdump, Wireshark and others: pcap and pcapng, in either byte order.

Read are packets of CAN, and what the ``any`` device of Linux caught of it (cooked captures, version 1 and 2); packets
of other links are skipped. An identifier stands in network byte order, in cooked captures in that of the file; where
most identifiers can only stand in the other one, as some writers leave them, all are swapped, and that is said.
"""

import os
import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO, Final, NamedTuple

from canlog.errors import SourceError
from canlog.frames import (
    BRS_FLAG,
    ERROR_FLAG,
    ESI_FLAG,
    EXTENDED_FLAG,
    FD_FLAG,
    FD_PAYLOAD_BYTES,
    NS_PER_US,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    TX_FLAG,
    Frame,
    FrameBatch,
    batch_of,
)
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.text_kernels import IS_LENGTH

SOCKETCAN, COOKED, COOKED_2 = LINKS = 227, 113, 276
# Where a cooked header has hardware, protocol, whether the packet was sent; its length.
COOKED_PLACES: Final = {COOKED: (2, 14, 1, 16), COOKED_2: (8, 0, 10, 20)}
COOKED_2_INTERFACE: Final = 4
CAN_HARDWARE, FD_PROTOCOL, XL_PROTOCOL, OUTGOING = 280, 0x000D, 0x000E, 4  # of if_arp.h and if_ether.h
INTERFACE, SIMPLE_PACKET, PACKET = 1, 3, 6  # kinds of blocks in pcapng
HEADER_BYTES, PACKET_BYTES, LEAST_BLOCK_BYTES = 16, 28, 12  # of a packet in pcap; in pcapng up to its data
FRAME_HEADER_BYTES, FD_FRAME_BYTES = 8, 72
LONGEST_PACKET, LONGEST_FRAME_PACKET, LONGEST_BLOCK = 262_144, 92, 16 * 1024 * 1024
MOST_STEP_S = 86_400  # from packet to packet, when searching for one behind damage
LAST_TIME_S = 9_200_000_000
NS_PER_S = 1_000_000_000
FD_BIT, XL_BIT = 0x04, 0x80  # of a frame's flags, of its length
STANDARD_ID, EXTENDED_ID, LAST_CLASS = 0x7FF, 0x1FFF_FFFF, 0xFFF  # the last one of errors

MAGICS: Final = {
    struct.pack(order + "L", magic): (order, ticks)
    for order in "<>"
    for magic, ticks in ((0xA1B2C3D4, 1_000_000), (0xA1B23C4D, 1_000_000_000))
}  # the byte order of the file, and into how many parts seconds are divided
SECTION_MAGIC: Final = b"\n\r\r\n"
CAPTURE_MAGICS: Final = (*MAGICS, SECTION_MAGIC)
BIG_ORDER_MAGIC: Final = bytes.fromhex("1A2B3C4D")
FILE_HEADER, FILE_HEADER_BYTES = "4s16xL", 24  # of pcap
LINK_MASK: Final = 0x0FFF_FFFF  # above it stands how long checksums are
PIECE_BYTES: Final = 1024 * 1024
MOST_INTERFACES, MOST_CHANNEL = 256, 255
MOST_TICKS: Final = 9_000_000_000  # in a second; finer ones overflow
NAME_OPTION, RESOLUTION_OPTION, OFFSET_OPTION = 2, 9, 14
LEAST_PACKETS: Final = 10  # needed to judge a byte order
MOST_ODD: Final = 0.1  # of packets whose identifiers stand in the right byte order
SWAPPED: Final = "the identifiers stand in the other byte order than this kind of capture has: they are read swapped"
DIGITS_AT_END: Final = re.compile(rb"(\d{1,3})\0*$")
# Where a record may begin behind damage, in pcap and in pcapng: small numbers at known places.
RECORDS: Final = {
    ("<", False): re.compile(rb"(?=.{8}([\x08-\x5c]\0\0\0)\1)", re.DOTALL),
    (">", False): re.compile(rb"(?=.{8}(\0\0\0[\x08-\x5c])\1)", re.DOTALL),
    ("<", True): re.compile(rb"\n\r\r\n|(?=[\x01-\x06]\0\0\0..[\0-\4]\0)", re.DOTALL),
    (">", True): re.compile(rb"\n\r\r\n|(?=\0\0\0[\x01-\x06]\0[\0-\4])", re.DOTALL),
}


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
    capture, tail, is_first = _opened(stream, counts), b"", True
    while True:
        piece = stream.read(PIECE_BYTES)
        packets, tail = capture.packets(tail + piece, goes_on=bool(piece))
        if is_first and _is_swapped(packets):
            capture.is_swapped = True
            counts.note(SWAPPED)
        is_first = is_first and not packets
        frames = capture.frames(packets)
        read_bytes = stream.seek(0, os.SEEK_CUR)
        if frames:
            counts.frames += len(frames)
            yield batch_of(frames)
        if not piece:
            break
    if tail or read_bytes < size_bytes:
        counts.cut_off(f"byte {read_bytes - len(tail)}")


class _Interface(NamedTuple):
    link: int
    ticks: int  # a second
    offset_s: int = 0  # to be added to its times
    channel: int = 0


class _Packet(NamedTuple):
    """A packet of CAN."""

    number: int
    t_ns: int
    channel: int
    flags: int
    protocol: int
    order: str  # of its identifier
    frame: bytes  # as SocketCAN has them


class _MalformedError(ValueError):
    """A packet of CAN holds no valid frame."""


@dataclass(slots=True)
class _Capture:
    """What is known of a capture at a packet."""

    counts: LogCounts
    order: str
    is_blocks: bool  # pcapng
    interfaces: list[_Interface] = field(default_factory=list)
    number: int = 0  # of packets until now
    last_s: int = 0
    is_lost: bool = False  # where the next record begins is not known
    is_swapped: bool = False

    def packets(self, raw: bytes, *, goes_on: bool) -> tuple[list[_Packet], bytes]:
        """Return the packets of CAN in a piece, and the beginning of a record that it does not hold whole.

        Where a record cannot be, the next place where one can be is looked for; that is counted as damage.
        """
        packets, at = list[_Packet](), 0
        while True:
            if self.is_lost:
                place = RECORDS[self.order, self.is_blocks].search(raw, at)
                at = place.start() if place else max(at, len(raw) - HEADER_BYTES + 1)
            size = self._record_bytes(raw, at)
            if size < 0:
                if not self.is_lost:
                    self.counts.reject(LogReject.DAMAGED, f"packet {self.number + 1}")
                self.is_lost, at = True, at + 1
            elif size == 0 or at + size > len(raw):
                is_over = self.is_lost and not goes_on  # nothing more to be found
                return packets, b"" if is_over else raw[at:]
            else:
                self.is_lost, record, at = False, raw[at : at + size], at + size
                try:
                    packet = self._packet(record)
                except _MalformedError:
                    self.counts.reject(LogReject.MALFORMED, f"packet {self.number}")
                else:
                    packets += [] if packet is None else [packet]

    def frames(self, packets: Sequence[_Packet]) -> list[Frame]:
        """Return the frames that packets hold; those that hold none are counted."""
        frames = list[Frame]()
        for packet in packets:
            try:
                frames.append(self._frame(packet))
            except _MalformedError:
                self.counts.reject(LogReject.MALFORMED, f"packet {packet.number}")
        return frames

    def _record_bytes(self, raw: bytes, at: int) -> int:
        """Return how long a record is, 0 if the piece ends before that, -1 if there can be none."""
        if at + (LEAST_BLOCK_BYTES if self.is_blocks else HEADER_BYTES) > len(raw):
            return 0
        if not self.is_blocks:
            seconds, part, size, whole = struct.unpack_from(f"{self.order}4L", raw, at)
            is_sound = size <= LONGEST_PACKET and part < self.interfaces[0].ticks
            if self.is_lost:
                is_sound &= FRAME_HEADER_BYTES <= size <= LONGEST_FRAME_PACKET and size == whole
                is_sound &= abs(seconds - self.last_s) <= MOST_STEP_S
            return HEADER_BYTES + size if is_sound else -1
        is_section = raw.startswith(SECTION_MAGIC, at)
        order = _section_order(raw, at) if is_section else self.order
        kind, size = struct.unpack_from(f"{order}2L", raw, at)
        least_bytes = PACKET_BYTES + 4 if kind == PACKET else LEAST_BLOCK_BYTES
        is_sound = size % 4 == 0 and least_bytes <= size <= LONGEST_BLOCK
        if self.is_lost:
            is_sound &= size <= LONGEST_PACKET and (is_section or 0 < kind <= PACKET)
        if not is_sound or at + size > len(raw):
            return size if is_sound else -1
        return size if struct.unpack_from(f"{order}L", raw, at + size - 4)[0] == size else -1

    def _packet(self, record: bytes) -> _Packet | None:
        """Return the packet of CAN that a record is, None if it is something else."""
        if self.is_blocks:
            kind = struct.unpack_from(f"{self.order}L", record)[0]
            if record.startswith(SECTION_MAGIC) or kind == INTERFACE:
                self._read_block(record)
                return None
            self.number += 1
            if kind == SIMPLE_PACKET:
                raise _MalformedError  # it has no time
            if kind != PACKET:
                self.counts.skipped += 1
                return None
            number, high, low, length = struct.unpack_from(f"{self.order}8x4L", record)
            if number >= len(self.interfaces) or length > len(record) - PACKET_BYTES - 4:
                raise _MalformedError
            interface = self.interfaces[number]
            seconds, part = divmod(high << 32 | low, interface.ticks)
            data = record[PACKET_BYTES : PACKET_BYTES + length]
        else:
            self.number += 1
            interface, data = self.interfaces[0], record[HEADER_BYTES:]
            seconds, part = struct.unpack_from(f"{self.order}2L", record)
        seconds += interface.offset_s
        if not 0 <= seconds < LAST_TIME_S:
            raise _MalformedError
        self.last_s = seconds
        time_ns = seconds * NS_PER_S + part * NS_PER_S // interface.ticks
        t_ns = (time_ns + NS_PER_US // 2) // NS_PER_US * NS_PER_US
        return self._of_link(interface, t_ns, data)

    def _of_link(self, interface: _Interface, t_ns: int, data: bytes) -> _Packet | None:
        """Return the packet of CAN that a link carried, None if it carried something else."""
        if interface.link == SOCKETCAN:
            return _Packet(self.number, t_ns, interface.channel, 0, 0, ">", data)
        hardware, protocol, sent, header = COOKED_PLACES.get(interface.link, (0, 0, 0, 0))
        if len(data) < header:
            raise _MalformedError
        if not header or struct.unpack_from(">H", data, hardware)[0] != CAN_HARDWARE:
            self.counts.skipped += 1
            return None
        channel = interface.channel
        if interface.link == COOKED_2:
            channel = min(struct.unpack_from(">L", data, COOKED_2_INTERFACE)[0], MOST_CHANNEL)
        flags, protocol = TX_FLAG * (data[sent] == OUTGOING), struct.unpack_from(">H", data, protocol)[0]
        return _Packet(self.number, t_ns, channel, flags, protocol, self.order, data[header:])

    def _frame(self, packet: _Packet) -> Frame:
        """Return the frame of a packet as SocketCAN has them."""
        data, flags = packet.frame, packet.flags
        if len(data) < FRAME_HEADER_BYTES or packet.protocol == XL_PROTOCOL or data[4] & XL_BIT:
            raise _MalformedError
        identifier, count, bits = _identifier(packet, is_swapped=self.is_swapped), data[4], data[5]
        is_remote = identifier & (REMOTE_FLAG | ERROR_FLAG) == REMOTE_FLAG
        is_fd = packet.protocol == FD_PROTOCOL or bits & FD_BIT or len(data) == FD_FRAME_BYTES or count > PAYLOAD_BYTES
        can_id = identifier & EXTENDED_ID | ERROR_FLAG if identifier & ERROR_FLAG else identifier
        if not identifier & (ERROR_FLAG | EXTENDED_FLAG) and can_id & ~REMOTE_FLAG > STANDARD_ID:
            raise _MalformedError
        stored = 0 if is_remote else count
        is_odd = is_fd and identifier & (REMOTE_FLAG | ERROR_FLAG)
        if is_odd or len(data) < FRAME_HEADER_BYTES + stored or count > FD_PAYLOAD_BYTES or not IS_LENGTH[count]:
            raise _MalformedError
        if is_fd:
            flags |= FD_FLAG | bits & (BRS_FLAG | ESI_FLAG)
        payload = data[FRAME_HEADER_BYTES : FRAME_HEADER_BYTES + stored]
        return Frame(packet.t_ns, can_id, count, payload, flags, packet.channel)

    def _read_block(self, block: bytes) -> None:
        """Read a section's header or the description of an interface."""
        if block.startswith(SECTION_MAGIC):
            self.order, self.interfaces = _section_order(block, 0), []
            return
        if len(self.interfaces) >= MOST_INTERFACES:
            return
        (link,) = struct.unpack_from(f"{self.order}8xH", block)
        options = dict(_options(block[16:-4], self.order))
        resolution = options.get(RESOLUTION_OPTION, b"\6")[0]
        ticks = 2 ** (resolution & 0x7F) if resolution & 0x80 else 10**resolution
        name = DIGITS_AT_END.search(options.get(NAME_OPTION, b""))
        offset_s = struct.unpack_from(f"{self.order}q", options.get(OFFSET_OPTION, b"").ljust(8, b"\0"))[0]
        channel = min(int(name[1]) if name else len(self.interfaces), MOST_CHANNEL)
        is_known = ticks <= MOST_TICKS
        self.interfaces.append(_Interface(link, ticks, offset_s, channel) if is_known else _Interface(0, 1))


def _opened(stream: BinaryIO, counts: LogCounts) -> _Capture:
    """Return what is known at the first packet."""
    header = stream.read(FILE_HEADER_BYTES)
    order, ticks = MAGICS.get(header[:4], ("", 0))
    if not order:
        stream.seek(0)
        return _Capture(counts, "<", is_blocks=True)
    if len(header) < FILE_HEADER_BYTES:
        raise SourceError("the capture ends inside its header")
    link = struct.unpack(order + FILE_HEADER, header)[1] & LINK_MASK
    return _Capture(counts, order, is_blocks=False, interfaces=[_Interface(link, ticks)])


def _section_order(raw: bytes, at: int) -> str:
    """Return the byte order of the section whose header stands here."""
    return ">" if raw.startswith(BIG_ORDER_MAGIC, at + 8) else "<"


def _identifier(packet: _Packet, *, is_swapped: bool) -> int:
    """Return an identifier with its flags, in the byte order that it should have or in the other one."""
    order = "<>"[packet.order == "<"] if is_swapped else packet.order
    return int(struct.unpack_from(f"{order}L", packet.frame)[0])


def _is_swapped(packets: Sequence[_Packet]) -> bool:
    """Return whether most identifiers cannot be in their byte order, and all but a few can in the other one."""
    whole = [packet for packet in packets if len(packet.frame) >= FRAME_HEADER_BYTES]
    odd, odd_swapped = (
        sum(_is_odd(_identifier(packet, is_swapped=is_swapped)) for packet in whole) for is_swapped in (False, True)
    )
    return len(packets) >= LEAST_PACKETS and odd > len(packets) / 2 and odd_swapped <= MOST_ODD * len(packets)


def _is_odd(identifier: int) -> bool:
    """Return whether an identifier is implausible: too large, an error of no class, 29 bits that end with 16 zeros."""
    if identifier & ERROR_FLAG:
        return identifier & ~ERROR_FLAG > LAST_CLASS
    return identifier & 0xFFFF == 0 if identifier & EXTENDED_FLAG else identifier & ~REMOTE_FLAG > STANDARD_ID


def _options(block: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield the options of a block that hold something."""
    at = 0
    while at + 4 <= len(block):
        code, size = struct.unpack_from(f"{order}HH", block, at)
        if size:
            yield code, block[at + 4 : at + 4 + size]
        at += 4 + size + -size % 4
