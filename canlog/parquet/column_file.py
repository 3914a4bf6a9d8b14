"""A Parquet file that grows by groups of rows, column by column."""

import base64
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import BinaryIO, Final

import numpy as np

from canlog.arrays import Int64Array
from canlog.parquet.codes import Packer
from canlog.parquet.contents import NOTHING, Content
from canlog.parquet.metadata import (
    MAGIC,
    ChunkFacts,
    ColumnType,
    Physical,
    chunk,
    data_page_header,
    dictionary_page_header,
    footer,
    row_group,
)
from canlog.parquet_file import BOOL_TYPE, NAME_TYPE, TIME_TYPE, arrow_schema, load_pyarrow

ZSTD_LEVEL: Final = 1  # higher ones take twice the time for a few percent
MOST_PLAIN_BYTES: Final = 96  # that become a frame of zstd as they are: hardly any smaller, and at once
MAKER: Final = "canlog"
TYPES: Final = {
    "float64": ColumnType(physical=Physical.DOUBLE),
    "int64": ColumnType(physical=Physical.INT64),
    "int32": ColumnType(physical=Physical.INT32),
    BOOL_TYPE: ColumnType(physical=Physical.BOOLEAN),
    TIME_TYPE: ColumnType(physical=Physical.INT64, is_time=True),
    NAME_TYPE: ColumnType(physical=Physical.TEXT),
}
_LENGTH: Final = struct.Struct("<I")
_FRAME_HEAD: Final = b"\x28\xb5\x2f\xfd\x20"  # of a zstd frame of one segment, whose size follows in a byte (RFC 8878)
_LAST_BLOCK: Final = 1  # and none before it; its bytes stand as they are
_NO_ROWS: Final = np.empty(0, np.int64)


@dataclass(frozen=True, slots=True)
class Levels:
    """Which rows of a group have a value: what the page of every column with these rows begins with."""

    row_count: int
    present_count: int
    size: int
    packed: bytes  # a frame of zstd by itself: that of the values follows it


class ColumnFile:
    """A Parquet file. Columns of a group of rows may be added in any order; those that are not are null.

    Which columns there are, is said at the end.

    Parameters
    ----------
    output : binary stream
        It stays open, and its errors are its own.
    packer
        Packs the columns; by default one of its own.

    Raises
    ------
    ExtraMissingError
        If pyarrow, which compresses, is not installed.
    """

    def __init__(self, output: BinaryIO, packer: Packer | None = None) -> None:
        self._compressed = load_pyarrow().Codec("zstd", compression_level=ZSTD_LEVEL).compress
        self._output = output
        self._at = 0
        self._groups: list[_Group] = []
        self._open = _Group()
        self.packer = packer or Packer()
        self._put(MAGIC)

    def levels(self, rows: Int64Array, count: int) -> Levels:
        """Return which of the ``count`` rows of a group have a value: some, rising."""
        return self._levels(self.packer.presence(rows, count), len(rows), count)

    def everywhere(self, count: int) -> Levels:
        """Return that all of the ``count`` rows of a group have a value: at least one."""
        return self._levels(self.packer.everywhere(count), count, count)

    def _levels(self, packed: bytes, present_count: int, count: int) -> Levels:
        whole = _LENGTH.pack(len(packed)) + packed
        return Levels(count, present_count, len(whole), self._packed(whole))

    def add(self, name: str, kind: str, levels: Levels, content: Content) -> None:
        """Write a column of the group: the values of those rows that have one; ``kind`` as of ``close``."""
        self._add(self._open, name, kind, levels, content)

    def end_group(self, row_count: int) -> None:
        """Complete a group of rows."""
        self._open.row_count = row_count
        self._groups.append(self._open)
        self._open = _Group()

    def close(self, kinds: Mapping[str, str], notes: Mapping[str, Mapping[str, str]]) -> None:
        """Write the end of the file.

        ``kinds`` are names and types of all columns in their order, ``notes`` what is to be known of them, as
        ``parquet_file.arrow_schema`` takes them.
        """
        for group in self._groups:
            missing = kinds.keys() - group.chunks.keys()
            nowhere = self.levels(_NO_ROWS, group.row_count)
            for name in missing:
                self._add(group, name, kinds[name], nowhere, NOTHING)
        groups = [
            row_group([group.chunks[name] for name in kinds], group.unpacked_bytes, group.row_count)
            for group in self._groups
        ]
        row_count = sum(group.row_count for group in self._groups)
        described = base64.b64encode(arrow_schema(kinds, notes).serialize().to_pybytes()).decode("ascii")
        types = {name: TYPES[kind] for name, kind in kinds.items()}
        self._put(footer(types, groups, row_count, {"ARROW:schema": described}, MAKER))

    def _add(self, group: "_Group", name: str, kind: str, levels: Levels, content: Content) -> None:
        began_at, unpacked_bytes, dictionary_at = self._at, 0, None
        if content.entries:
            dictionary_at, packed = self._at, self._packed(content.entries)
            header = dictionary_page_header(content.entry_count, len(content.entries), len(packed))
            self._put(header, packed)
            unpacked_bytes = len(header) + len(content.entries)
        data_at, packed, size = self._at, self._packed(content.body), levels.size + len(content.body)
        header = data_page_header(levels.row_count, content.encoding, size, len(levels.packed) + len(packed))
        self._put(header, levels.packed, packed)
        unpacked_bytes += len(header) + size
        facts = ChunkFacts(
            encoding=content.encoding,
            row_count=levels.row_count,
            null_count=levels.row_count - levels.present_count,
            unpacked_bytes=unpacked_bytes,
            packed_bytes=self._at - began_at,
            data_at=data_at,
            dictionary_at=dictionary_at,
            limits=content.limits,
        )
        group.chunks[name] = chunk(name, TYPES[kind], facts)
        group.unpacked_bytes += unpacked_bytes

    def _packed(self, content: bytes) -> bytes:
        size = len(content)
        if size <= MOST_PLAIN_BYTES:
            return _FRAME_HEAD + bytes((size, size << 3 & 0xFF | _LAST_BLOCK, size >> 5, 0)) + content
        packed: bytes = self._compressed(content, asbytes=True)
        return packed

    def _put(self, *parts: bytes) -> None:
        for part in parts:
            self._output.write(part)
            self._at += len(part)


@dataclass(slots=True)
class _Group:
    """A group of rows: where its columns are, as the footer says it."""

    chunks: dict[str, bytes] = field(default_factory=dict)
    unpacked_bytes: int = 0
    row_count: int = 0
