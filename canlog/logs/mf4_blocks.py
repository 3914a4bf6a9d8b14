"""The blocks of an MDF 4 file, as far as it takes to find records and what is measured (ASAM MDF 4.2)."""

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from html import unescape
from typing import BinaryIO, NamedTuple

import numpy as np

HEADER = struct.Struct("<4s4xQQ")  # kind, length with the header, links
LINK = struct.Struct("<Q")
GROUP = struct.Struct("<QQHH4xLL")  # of a channel group: record id, cycles, flags, separator, bytes, invalidation bytes
PACKED = struct.Struct("<2sBxLQQ")  # of a DZ block: kind of what it holds, way, parameter, length of it, length here
FIRST_BLOCK = 64
MOST_BLOCKS = 1_000_000
PIECE_BYTES = 1024 * 1024
MOST_LINKS = 100_000
VARIABLE_LENGTH = 0x0001  # flags of a channel group: its records begin with their length,
REMOTE_MASTER = 0x0008  # its records are stored by columns
DEFLATED, TRANSPOSED = 0, 1
MOST_UNPACKED_BYTES = 64 * 1024 * 1024  # of one block; the format's own limit is 4 MiB
PLAIN, ZIPPED, LISTED, LIST_HEADER = b"##DT", b"##DZ", b"##DL", b"##HL"
DATA = {PLAIN, ZIPPED}
CHANNEL, CHANNEL_GROUP, CHANNEL_DATA = b"##CN", b"##CG", 5  # the last: which of a channel's links leads to its data
COMPOSITION, NAME, CONVERSION, UNIT = 1, 2, 4, 6  # likewise
FIELDS = struct.Struct("<BBB")  # of a channel: what it is to its group, of which quantity a master is, kind of number
MASTERS, TIME, NUMBERS = {2, 3}, 1, range(6)
UNIT_OF_CONVERSION, FIRST_REFERENCE = 1, 4  # links of a conversion
FORMULA, TO_NUMBERS = 3, range(9)  # kinds of conversion; the last two name numbers in words, which are left alone
SAFE_FORMULA = re.compile(r"[-+*/(). \dEeX]{1,200}")
PLAIN_BUS_EVENTS = 0x0004  # flag of a channel group: its records are frames; those of signals decoded of them lack it
BUS_FRAMES = re.compile(r"(?:CAN|LIN|FLX|ETH|MOST|KLINE|K)_?\w*(?:Frame|Error|Event|Message)\w*")
LONGEST_TEXT = 64 * 1024
TEXT_IN_XML = re.compile(r"<TX>(.*?)</TX>", re.DOTALL)
MOST_CHANNELS = 20_000  # with their groups


class UnknownStructureError(Exception):
    """The file is not built as is understood here, or the end of it is missing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """The head of a block."""

    kind: bytes
    at: int
    length: int
    links: tuple[int, ...]

    @property
    def body_at(self) -> int:
        """Where what follows the links is."""
        return self.at + HEADER.size + LINK.size * len(self.links)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelGroup:
    """One kind of record."""

    at: int
    cycles_at: int  # where in the file the count of its records is
    bytes_at: int  # where the size of its records is; of records of variable length that of all of them
    record_id: int
    stated: int  # records, as the file says
    record_bytes: int
    is_variable: bool
    parts: tuple[int, ...]  # channel groups of variable length that hold a part of each of its records


@dataclass(frozen=True, slots=True, kw_only=True)
class DataGroup:
    """Records that are stored together."""

    link_at: int  # where in the file the address of its data is
    data_at: int
    id_bytes: int
    groups: tuple[ChannelGroup, ...]


class Channel(NamedTuple):
    """A measured signal that is a number, and where its block is."""

    at: int
    name: str
    unit: str


class MeasuredGroup(NamedTuple):
    """Channels that share their times; ``is_bus`` if its records are frames of a bus."""

    at: int
    channels: tuple[Channel, ...]
    has_times: bool
    is_bus: bool
    others: tuple[str, ...]  # names of channels that are no numbers, or become such by an unknown formula


@dataclass(frozen=True, slots=True, kw_only=True)
class Stored:
    """The blocks with the records of a data group."""

    blocks: tuple[Block, ...]
    is_cut: bool  # the file ends inside one, or before one that it names


class Mf4File:
    """An MDF 4 file whose end may be missing."""

    def __init__(self, stream: BinaryIO, size_bytes: int, *, is_unfinished: bool) -> None:
        self._stream = stream
        self.size_bytes = size_bytes
        self._is_unfinished = is_unfinished
        self.data_ranges: list[tuple[int, int]] = []  # of what ``records_of`` has gone through

    def data_groups(self) -> list[DataGroup]:
        """Return all groups of the file.

        Raises UnknownStructureError if one is missing, or stored in a way that is not understood here.
        """
        found = list[DataGroup]()
        for block in self._chain(self._need(FIRST_BLOCK, b"##HD").links[0], b"##DG"):
            groups = tuple(self._channel_group(one) for one in self._chain(block.links[1], CHANNEL_GROUP))
            link_at, id_bytes = block.at + HEADER.size + 2 * LINK.size, self._bytes(block.body_at, 1)[0]
            found.append(DataGroup(link_at=link_at, data_at=block.links[2], id_bytes=id_bytes, groups=groups))
        return found

    def measured_groups(self) -> list[MeasuredGroup]:
        """Return all groups that have records, with their channels; raises UnknownStructureError."""
        found, count = list[MeasuredGroup](), 0
        for data in self._chain(self._need(FIRST_BLOCK, b"##HD").links[0], b"##DG", MOST_CHANNELS):
            count += 1
            for group in self._chain(data.links[1], CHANNEL_GROUP, MOST_CHANNELS - count):
                _, cycles, flags, _, _, _ = GROUP.unpack(self._bytes(group.body_at, GROUP.size))
                blocks = list(self._chain(group.links[1], CHANNEL, MOST_CHANNELS - count))
                count += 1 + len(blocks)
                if (cycles or self._is_unfinished) and not flags & VARIABLE_LENGTH:
                    found.append(self._measured(group, flags, blocks))
        return found

    def _measured(self, group: Block, flags: int, blocks: list[Block]) -> MeasuredGroup:
        channels, others, has_times = list[Channel](), list[str](), False
        for block in blocks:
            role, quantity, kind = FIELDS.unpack(self._bytes(block.body_at, FIELDS.size))
            name = self._text(block.links[NAME])
            if role in MASTERS:
                has_times |= quantity == TIME
            elif block.links[COMPOSITION] or kind not in NUMBERS or not self._is_number(block.links[CONVERSION]):
                others.append(name)
            else:
                unit, at = self._text(block.links[UNIT]), block.links[CONVERSION]
                if not unit and at:
                    unit = self._text(self._need(at, b"##CC").links[UNIT_OF_CONVERSION])
                channels.append(Channel(block.at, name, unit))
        is_bus = bool(flags & PLAIN_BUS_EVENTS) or any(BUS_FRAMES.fullmatch(one) for one in others)
        return MeasuredGroup(group.at, tuple(channels), has_times, is_bus, tuple(others))

    def _is_number(self, conversion_at: int) -> bool:
        if not conversion_at:
            return True
        block = self._need(conversion_at, b"##CC")
        kind = self._bytes(block.body_at, 1)[0]
        if kind == FORMULA:
            return SAFE_FORMULA.fullmatch(self._text(block.links[FIRST_REFERENCE])) is not None
        return kind in TO_NUMBERS

    def _text(self, at: int) -> str:
        """Return the text of a block of text, or the first one in its XML."""
        if not at:
            return ""
        block = self._need(at)
        length = min(block.length - HEADER.size, LONGEST_TEXT, self.size_bytes - block.body_at)
        text = self._bytes(block.body_at, max(length, 0)).partition(b"\0")[0].decode("utf-8", "replace")
        if block.kind == b"##MD":
            found = TEXT_IN_XML.search(text)
            text = unescape(found[1]) if found else ""
        return text.strip()

    def stored(self, group: DataGroup) -> Stored:
        """Return the blocks with a group's records.

        Raises UnknownStructureError if they are stored in a way that is not understood here.
        """
        if not group.data_at:
            return Stored(blocks=(), is_cut=False)
        block = self._find(group.data_at)
        if block is not None and block.kind == LIST_HEADER:
            block = self._find(block.links[0])
        if block is None:
            return Stored(blocks=(), is_cut=True)
        blocks, is_short = ([block], False) if block.kind in DATA else self._listed(block)
        if self._is_unfinished:
            blocks = [self._grown(one) for one in blocks]
            last = blocks[-1] if blocks else block
            blocks += self._unlisted(last.at + last.length) if block.kind == LISTED else []
        is_cut = is_short or any(one.at + one.length > self.size_bytes for one in blocks)
        return Stored(blocks=tuple(blocks), is_cut=is_cut)

    def records_of(self, stored: Stored) -> Iterator[bytes]:
        """Yield the bytes of records in pieces, up to where they end or the file does."""
        for block in stored.blocks:
            if block.kind != PLAIN:
                yield self._unpacked(block)
                continue
            at, end = block.body_at, min(block.at + block.length, self.size_bytes)
            self.data_ranges.append((at, end))
            for begin in range(at, end, PIECE_BYTES):
                yield self._bytes(begin, min(PIECE_BYTES, end - begin))

    def _channel_group(self, block: Block) -> ChannelGroup:
        record_id, cycles, flags, _, data_bytes, invalid_bytes = GROUP.unpack(self._bytes(block.body_at, GROUP.size))
        if flags & REMOTE_MASTER:
            raise UnknownStructureError("records by columns")
        return ChannelGroup(
            at=block.at,
            cycles_at=block.body_at + 8,
            bytes_at=block.body_at + 24,
            record_id=record_id,
            stated=cycles,
            record_bytes=data_bytes + invalid_bytes,
            is_variable=bool(flags & VARIABLE_LENGTH),
            parts=self._parts(block.links[1]),
        )

    def _parts(self, first_at: int) -> tuple[int, ...]:
        """Return the channel groups to which channels, and those that they are composed of, refer for their data."""
        parts: list[int] = []
        waiting = [first_at]
        for _ in range(MOST_BLOCKS):
            if not waiting:
                return tuple(parts)
            channel = self._find(waiting.pop())
            if channel is None or channel.kind != CHANNEL or len(channel.links) <= CHANNEL_DATA:
                continue
            waiting += [at for at in channel.links[:2] if at]  # the next one, and what this one is composed of
            data_at = channel.links[CHANNEL_DATA]
            if data_at and (block := self._find(data_at)) is not None and block.kind == CHANNEL_GROUP:
                parts.append(data_at)
        raise UnknownStructureError("blocks in a ring")

    def _chain(self, at: int, kind: bytes, most: int = MOST_BLOCKS) -> Iterator[Block]:
        """Yield blocks that are linked by their first links, so many at most."""
        for _ in range(most):
            if not at:
                return
            block = self._need(at, kind)
            yield block
            at = block.links[0]
        raise UnknownStructureError("blocks in a ring")

    def _listed(self, block: Block) -> tuple[list[Block], bool]:
        """Return the data blocks of a chain of lists, and whether one that it names is missing."""
        found: list[Block] = []
        for _ in range(MOST_BLOCKS):
            if block.kind != LISTED:
                raise UnknownStructureError("records in blocks of another kind")
            for data_at in block.links[1:]:
                data = self._find(data_at) if data_at else None
                if data is None:
                    return found, bool(data_at)
                if data.kind not in DATA:
                    raise UnknownStructureError("records in blocks of another kind")
                found.append(data)
            following = self._find(block.links[0]) if block.links[0] else None
            if following is None:
                return found, bool(block.links[0])
            block = following
        raise UnknownStructureError("blocks in a ring")

    def _unlisted(self, at: int) -> list[Block]:
        """Return the blocks that stand behind the last that a list has, which its writer did not come to complete."""
        found: list[Block] = []
        while (block := self._find(at + -at % 8)) is not None and block.kind in DATA:
            found.append(self._grown(block))
            at = found[-1].at + max(found[-1].length, HEADER.size)
        return found

    def _grown(self, block: Block) -> Block:
        """Return a block with the length that it has: of the last one its writer may not have noted it yet."""
        end = block.at + block.length
        if block.kind != PLAIN or end + -end % 8 >= self.size_bytes:
            return block
        if block.length > HEADER.size and self._find(end + -end % 8) is not None:
            return block
        return Block(kind=block.kind, at=block.at, length=self._next_block(block.at) - block.at, links=())

    def _next_block(self, at: int) -> int:
        """Return where the next block begins, else the end of the file."""
        at += HEADER.size
        while at < self.size_bytes:
            piece = self._bytes(at, min(PIECE_BYTES, self.size_bytes - at))
            place = piece.find(b"##")
            while place >= 0:
                if (at + place) % 8 == 0 and self._find(at + place) is not None:
                    return at + place
                place = piece.find(b"##", place + 1)
            at += max(len(piece) - 1, 1)
        return self.size_bytes

    def _unpacked(self, block: Block) -> bytes:
        """Return what a packed block holds, as far as it is there; transposed it must be there whole."""
        at = block.body_at + PACKED.size
        if at > self.size_bytes:
            return b""
        _, way, columns, whole_bytes, packed_bytes = PACKED.unpack(self._bytes(block.body_at, PACKED.size))
        end = min(at + packed_bytes, self.size_bytes)
        self.data_ranges.append((at, end))
        if way not in {DEFLATED, TRANSPOSED} or whole_bytes > MOST_UNPACKED_BYTES:
            raise UnknownStructureError("records packed in another way")
        try:
            data = zlib.decompressobj().decompress(self._bytes(at, end - at), whole_bytes)
        except zlib.error:
            return b""
        if way == DEFLATED:
            return data
        return transposed(data, columns) if len(data) == whole_bytes and columns else b""

    def _find(self, at: int) -> Block | None:
        """Return the block at an address, None if there is none."""
        try:
            return self._need(at)
        except UnknownStructureError:
            return None

    def _need(self, at: int, kind: bytes | None = None) -> Block:
        found, length, links = HEADER.unpack(self._bytes(at, HEADER.size))
        is_block = found[:2] == b"##" and found[2:].isalpha() and links <= MOST_LINKS
        if not is_block or (kind is not None and found != kind):
            raise UnknownStructureError(f"no block at byte {at}")
        addresses = self._bytes(at + HEADER.size, LINK.size * links)
        return Block(kind=found, at=at, length=length, links=tuple(one for (one,) in LINK.iter_unpack(addresses)))

    def _bytes(self, at: int, count: int) -> bytes:
        if at < 0 or at + count > self.size_bytes:
            raise UnknownStructureError(f"the file ends before byte {at + count}")
        self._stream.seek(at)
        return self._stream.read(count)


def transposed(data: bytes, columns: int) -> bytes:
    """Return bytes in the order they had before they were stored column by column; what is left over stays."""
    whole_bytes = len(data) // columns * columns
    stored = np.frombuffer(data, np.uint8, whole_bytes).reshape(columns, -1)
    return stored.T.tobytes() + data[whole_bytes:]
