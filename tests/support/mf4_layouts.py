"""MDF 4 files as recorders write them: what the blocks mean first, records last, closed or not.

asammdf writes records first; here they are moved behind everything else, into blocks of any kind.
"""

import struct
import zlib
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

HEADER: Final = struct.Struct("<4s4xQQ")
RECORD_ID: Final = 7
RECORDS_PER_BLOCK: Final = 40


class Layout(StrEnum):
    """How records are stored."""

    PLAIN = "DT"
    LISTED = "DL"
    ZIPPED = "DZ"
    ZIPPED_LIST = "HL, DZ"
    TRANSPOSED_LIST = "HL, DZ by columns"


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """A file and where its records are."""

    contents: bytes
    record_bytes: int
    data_at: int  # where the first data block begins
    record_ends: tuple[int, ...]  # where each record ends in the file; where they are packed, where its block does


def _links(contents: bytes | bytearray, at: int) -> list[int]:
    count = HEADER.unpack_from(contents, at)[2]
    return list(struct.unpack_from(f"<{count}Q", contents, at + HEADER.size))


def _block(kind: bytes, links: list[int], body: bytes) -> bytes:
    size = HEADER.size + 8 * len(links) + len(body)
    return HEADER.pack(kind, size, len(links)) + struct.pack(f"<{len(links)}Q", *links) + body + bytes(-size % 8)


def _data_blocks(layout: Layout, pieces: list[bytes], record_bytes: int) -> list[bytes]:
    if layout in {Layout.PLAIN, Layout.LISTED}:
        return [_block(b"##DT", [], piece) for piece in pieces]
    blocks = []
    for piece in pieces:
        packed = piece
        if layout is Layout.TRANSPOSED_LIST:
            lines = len(piece) // record_bytes
            packed = bytes(
                piece[line * record_bytes + column] for column in range(record_bytes) for line in range(lines)
            )
        deflated = zlib.compress(packed)
        way = layout is Layout.TRANSPOSED_LIST
        head = struct.pack("<2sBxLQQ", b"DT", way, record_bytes if way else 0, len(piece), len(deflated))
        blocks.append(_block(b"##DZ", [], head + deflated))
    return blocks


def laid_out(path: Path, layout: Layout, *, is_sorted: bool, is_finished: bool, is_listed: bool = True) -> Recording:
    """Return a file that asammdf wrote uncompressed, with its one group's records moved to the end.

    ``is_listed``: whether an unfinished list already names the blocks that it will have.
    """
    contents = bytearray(path.read_bytes())
    group_at = _links(contents, 64)[0]
    channels_at, data_at = _links(contents, group_at)[1:3]
    body_at = channels_at + HEADER.size + 8 * HEADER.unpack_from(contents, channels_at)[2]
    count = struct.unpack_from("<Q", contents, body_at + 8)[0]
    data_bytes, invalid_bytes = struct.unpack_from("<LL", contents, body_at + 24)
    record_bytes = data_bytes + invalid_bytes
    stored = bytes(contents[data_at + HEADER.size :][: count * record_bytes])
    records = [stored[at : at + record_bytes] for at in range(0, len(stored), record_bytes)]
    if not is_sorted:
        records = [bytes([RECORD_ID]) + record for record in records]
        struct.pack_into("<Q", contents, body_at, RECORD_ID)
        group_body_at = group_at + HEADER.size + 8 * HEADER.unpack_from(contents, group_at)[2]
        contents[group_body_at] = 1
    contents += bytes(-len(contents) % 8)
    per_block = len(records) if layout in {Layout.PLAIN, Layout.ZIPPED} else RECORDS_PER_BLOCK
    pieces = [b"".join(records[first : first + per_block]) for first in range(0, len(records), per_block)]
    blocks = _data_blocks(layout, pieces, len(records[0]))
    list_at = first_at = len(contents)
    if layout in {Layout.ZIPPED_LIST, Layout.TRANSPOSED_LIST}:
        contents += _block(b"##HL", [len(contents) + 40], struct.pack("<HB5x", 1, layout is Layout.TRANSPOSED_LIST))
        list_at = len(contents)
    if layout not in {Layout.PLAIN, Layout.ZIPPED}:
        offsets = [sum(len(piece) for piece in pieces[:number]) for number in range(len(pieces))]
        body = struct.pack(f"<B3xL{len(pieces)}Q", 0, len(pieces), *offsets)
        at = list_at + HEADER.size + 8 * (1 + len(pieces)) + len(body)
        addresses = []
        for block in blocks:
            addresses.append(at + -at % 8)
            at = addresses[-1] + len(block)
        links = addresses if is_finished or is_listed else addresses[:1] + [0] * (len(addresses) - 1)
        contents += _block(b"##DL", [0, *links], body)
    struct.pack_into("<Q", contents, group_at + HEADER.size + 16, first_at)
    begin, ends = len(contents), []
    for block, piece in zip(blocks, pieces, strict=True):
        at = len(contents) + HEADER.size
        is_packed = layout not in {Layout.PLAIN, Layout.LISTED}
        size = HEADER.unpack_from(block)[1]
        counts = range(1, len(piece) // len(records[0]) + 1)
        ends += [len(contents) + size if is_packed else at + number * len(records[0]) for number in counts]
        contents += block
    if not is_finished:
        contents[:8] = b"UnFinMF "
        struct.pack_into("<H", contents, 60, 0b10101)  # counts, the last data block, the last list
        struct.pack_into("<Q", contents, body_at + 8, 0)
        if layout is Layout.PLAIN:
            struct.pack_into("<Q", contents, begin + 8, HEADER.size)
            del contents[ends[-1] :]
    return Recording(contents=bytes(contents), record_bytes=len(records[0]), data_at=begin, record_ends=tuple(ends))
