"""MDF 4 files whose end is missing, or whose writer did not close them, made whole in a copy as far as they go.

asammdf completes a file that ends with a whole record; of others it reads nothing. Here the records that are there are
counted and written behind each other into a copy, with the counts and addresses that they need; what else the file
holds is copied as it is.
"""

import os
import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from canlog.errors import SourceError
from canlog.logs.mf4_blocks import (
    HEADER,
    LINK,
    PIECE_BYTES,
    PLAIN,
    ChannelGroup,
    DataGroup,
    Mf4File,
    Stored,
    UnknownStructureError,
)

UNFINISHED_MAGIC, FINISHED_MAGIC = b"UnFinMF ", b"MDF     "
FLAGS_AT, FLAGS = 60, struct.Struct("<HH")  # what is unfinished, by the standard and by its writer's own list
LENGTH = struct.Struct("<L")  # before a record of variable length
COUNT = struct.Struct("<Q")
ALIGNMENT_BYTES = 8
MOST_RATIO, FREE_BYTES = 256, 64 * 1024 * 1024  # of records to the file that they are packed in


@dataclass(frozen=True, slots=True, kw_only=True)
class Mended:
    """A file that can be read, and what is missing of it."""

    path: Path
    found: Mapping[int, int] = field(default_factory=dict)  # whole records, by the address of their channel group
    missing: Mapping[int, int] = field(default_factory=dict)
    is_cut: bool = False
    lost_at: str = ""  # where bytes are that belong to no record


def mended(path: Path, folder: Path) -> Mended:
    """Return a file that is whole: this one, or a copy in a folder with what is there of it.

    Raises SourceError if its records are packed so that they cannot be a log's.
    """
    size_bytes = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(FLAGS_AT + FLAGS.size)
        if len(head) < FLAGS_AT + FLAGS.size:
            return Mended(path=path)
        is_unfinished = head.startswith(UNFINISHED_MAGIC) or any(FLAGS.unpack_from(head, FLAGS_AT))
        file = Mf4File(stream, size_bytes, is_unfinished=is_unfinished)
        try:
            groups = [(group, file.stored(group)) for group in file.data_groups()]
            if not is_unfinished and not any(stored.is_cut for _, stored in groups):
                return Mended(path=path)
            return _copied(stream, file, groups, folder / f"mended-{os.urandom(6).hex()}.mf4")
        except UnknownStructureError:
            return Mended(path=path)  # asammdf may know better, or says what is wrong


class RecordCounter:
    """Cuts the bytes of a data group into records and counts them."""

    def __init__(self, group: DataGroup) -> None:
        self._id_bytes = group.id_bytes
        self._groups = {one.record_id: one for one in group.groups}
        self._only = group.groups[0] if group.groups and not group.id_bytes else None
        self._rest = b""
        self.is_lost = False  # whether records of an unknown kind follow
        self.found: Counter[int] = Counter({one.at: 0 for one in group.groups})
        self.stand_ins: Counter[int] = Counter()
        self.variable_bytes: Counter[int] = Counter()  # of records of variable length

    def whole_records(self, pieces: Iterable[bytes]) -> Iterator[bytes]:
        """Yield the bytes of whole records, up to the first byte that belongs to none."""
        for piece in pieces:
            data = self._rest + piece
            if (group := self._only) is None:
                end = self._end_of_unsorted(data)
            elif not group.record_bytes or group.is_variable:
                self.is_lost, end = True, 0
            else:
                end = len(data) // group.record_bytes * group.record_bytes
                self.found[group.at] += len(data) // group.record_bytes
            yield data[:end]
            self._rest = data[end:]
            if self.is_lost:
                break
        yield from self._stand_ins()

    def whole(self, group: ChannelGroup) -> int:
        return min([self.found[group.at], *(self.found[part] for part in group.parts if part in self.found)])

    def missing(self, stored: Stored) -> dict[int, int]:
        """Return how many records each channel group lacks: those that it states, and one that is there in part."""
        lacking = {one.at: max(one.stated, self.found[one.at]) - self.whole(one) for one in self._groups.values()}
        is_padding = not stored.is_cut and len(self._rest) < ALIGNMENT_BYTES and not any(self._rest)
        begun = self._only or self._groups.get(int.from_bytes(self._rest[: self._id_bytes], "little"))
        if self._rest and not is_padding and not self.is_lost and begun is not None:
            lacking[begun.at] = max(lacking[begun.at], 1)
        return {at: count for at, count in lacking.items() if count}

    def _stand_ins(self) -> Iterator[bytes]:
        """Yield empty parts for records whose own are missing: asammdf reads none of them otherwise."""
        by_address = {one.at: one for one in self._groups.values()}
        for group in self._groups.values():
            for part in (by_address[at] for at in group.parts if at in by_address):
                lacking = max(self.found[group.at] - self.found[part.at], 0)
                self.stand_ins[part.at] += lacking
                self.variable_bytes[part.at] += LENGTH.size * lacking
                yield (part.record_id.to_bytes(self._id_bytes, "little") + LENGTH.pack(0)) * lacking

    def _end_of_unsorted(self, data: bytes) -> int:
        at, id_bytes, groups, found = 0, self._id_bytes, self._groups, self.found
        while at + id_bytes <= len(data):
            group = groups.get(int.from_bytes(data[at : at + id_bytes], "little"))
            if group is None:
                self.is_lost = True
                break
            end = at + id_bytes + _record_bytes(group, data, at + id_bytes)
            if end > len(data):
                break
            found[group.at] += 1
            if group.is_variable:
                self.variable_bytes[group.at] += end - at - id_bytes
            at = end
        return at


def _record_bytes(group: ChannelGroup, data: bytes, at: int) -> int:
    """Return the length of a record behind its id; more than there is where it does not say it yet."""
    if not group.is_variable:
        return group.record_bytes
    if at + LENGTH.size > len(data):
        return len(data) + 1
    return LENGTH.size + int(LENGTH.unpack_from(data, at)[0])


def _copied(stream: BinaryIO, file: Mf4File, groups: Sequence[tuple[DataGroup, Stored]], path: Path) -> Mended:
    """Write the copy; return what it holds."""
    found, missing, lost_at = Counter[int](), Counter[int](), ""
    changes = {0: FINISHED_MAGIC, FLAGS_AT: FLAGS.pack(0, 0)}
    with path.open("wb") as copy:
        for group, stored in groups:
            at = max(copy.seek(0, os.SEEK_END), file.size_bytes)
            at += -at % ALIGNMENT_BYTES
            copy.seek(at + HEADER.size)
            counter, kept = RecordCounter(group), 0
            for piece in counter.whole_records(file.records_of(stored)):
                kept += copy.write(piece)
                if kept > FREE_BYTES + MOST_RATIO * file.size_bytes:
                    raise SourceError(f"the MF4 file holds more than {MOST_RATIO} times its size: no log does")
            changes |= {at: HEADER.pack(PLAIN, HEADER.size + kept, 0), group.link_at: LINK.pack(at if kept else 0)}
            for one in group.groups:
                changes[one.cycles_at] = COUNT.pack(counter.found[one.at] + counter.stand_ins[one.at])
                if one.is_variable:
                    changes[one.bytes_at] = COUNT.pack(counter.variable_bytes[one.at])
                found[one.at] = counter.whole(one)
            missing.update(counter.missing(stored))
            lost_at = lost_at or (f"byte {kept + 1} of the records" if counter.is_lost else "")
        _copy_rest(stream, copy, file)
        for at, contents in changes.items():
            copy.seek(at)
            copy.write(contents)
    is_cut = any(stored.is_cut for _, stored in groups) or bool(missing)
    return Mended(path=path, found=found, missing=missing, is_cut=is_cut, lost_at=lost_at)


def _copy_rest(stream: BinaryIO, copy: BinaryIO, file: Mf4File) -> None:
    """Copy what is not records; zeros stay holes."""
    at = 0
    for begin, end in sorted([*file.data_ranges, (file.size_bytes, file.size_bytes)]):
        while at < begin:
            stream.seek(at)
            piece = stream.read(min(PIECE_BYTES, begin - at))
            if not piece:
                return
            if piece.strip(b"\0"):
                copy.seek(at)
                copy.write(piece)
            at += len(piece)
        at = max(at, end)
