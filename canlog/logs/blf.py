"""Vector BLF files: from containers on disk to one stream of objects, whatever is damaged.

The layout follows the structures that python-can documents; the start of measurement counts as UTC, as it does there.
No size in the file is trusted: every step makes progress or gives up, and what is damaged is counted and stepped over.
"""

import os
import struct
import zlib
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import BinaryIO, NamedTuple

from canlog.errors import SourceError
from canlog.frames import FrameBatch
from canlog.logs.blf_objects import LONGEST_PADDING, OBJECT_HEADER, OBJECT_MAGIC, ObjectStream
from canlog.logs.inflating import sound_contents
from canlog.logs.log_counts import LogCounts, LogReject

MAGIC = b"LOGG"
FILE_HEADER = struct.Struct("<4sL8BQQLL8H8H")
FILE_SIZE_FIELD = 10
START_FIELDS = slice(14, 22)  # SYSTEMTIME: year, month, day of week, day, hour, minute, second, millisecond
CONTAINER_HEADER = struct.Struct("<H6xL4x")  # compression, inflated size
FRAMES_PER_BATCH = 65_536
FRAMES_PER_CONTAINER = 4_096  # in the 128 KiB that writers use, and a little more
LOG_CONTAINER = 10
CONTAINER_OBJECT_BYTES = 16  # of the header of a container; all others have longer ones
STORED, DEFLATED = 0, 2
MAX_CONTAINER_BYTES = 64 * 1024 * 1024  # writers use 128 KiB
SEARCH_BYTES = 1024 * 1024
US_PER_S = 1_000_000
LAST_START_S = 9_000_000_000  # the year 2255: nanoseconds must fit 64 bits


def read_blf(stream: BinaryIO, counts: LogCounts) -> Iterator[FrameBatch]:
    """Yield the frames of a BLF file, one batch for several containers.

    Raises
    ------
    SourceError
        If the file ends inside its own header.
    """
    header = stream.read(FILE_HEADER.size)
    if len(header) < FILE_HEADER.size:
        raise SourceError("the BLF file ends inside its header")
    fields = FILE_HEADER.unpack(header)
    header_bytes = max(int(fields[1]), FILE_HEADER.size)
    size_bytes = stream.seek(0, os.SEEK_END)
    # A writer that was killed left the size of an empty file; one that was cut is shorter than it says.
    stated_bytes = int(fields[FILE_SIZE_FIELD])
    counts.truncated = size_bytes < stated_bytes or stated_bytes <= header_bytes < size_bytes
    objects = ObjectStream(start_us(fields[START_FIELDS]), counts, FRAMES_PER_BATCH + FRAMES_PER_CONTAINER)
    for data, is_whole in containers(stream, header_bytes, size_bytes, counts):
        objects.feed(data)
        if not is_whole:
            objects.lose_track()
        if len(objects) >= FRAMES_PER_BATCH:  # of many containers: what works on columns wants long ones
            yield objects.hand_over()
    objects.finish()
    if len(objects):
        yield objects.hand_over()


def start_us(systemtime: tuple[int, ...]) -> int:
    """Return the start of measurement in microseconds since the epoch; 0 if the file does not say."""
    year, month, _, day, hour, minute, second, millisecond = systemtime
    try:
        start = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return 0
    start_s = int(start.timestamp())
    return start_s * US_PER_S + millisecond * 1_000 if 0 <= start_s <= LAST_START_S else 0


def containers(
    stream: BinaryIO, position: int, size_bytes: int, counts: LogCounts
) -> Iterator[tuple[bytes | bytearray, bool]]:
    """Yield the inflated contents of each container and whether nothing of it is missing.

    Objects outside containers are passed on as they are.
    """
    is_lost = False
    while (position := next_object(stream, position, size_bytes, None if is_lost else counts)) < size_bytes:
        stream.seek(position)
        header = stream.read(OBJECT_HEADER.size)
        if len(header) < OBJECT_HEADER.size:
            counts.cut_off(f"byte {position}")
            return
        _, header_bytes, _, object_bytes, object_type = OBJECT_HEADER.unpack(header)
        if not OBJECT_HEADER.size <= object_bytes <= MAX_CONTAINER_BYTES:
            counts.reject(LogReject.DAMAGED, f"byte {position}")
            position, is_lost = position + len(OBJECT_MAGIC), True
            continue
        body = stream.read(object_bytes - OBJECT_HEADER.size)
        is_whole = len(body) == object_bytes - OBJECT_HEADER.size
        # A container whose type or header size is damaged still inflates to what its checksum says.
        is_container = object_type == LOG_CONTAINER or header_bytes == CONTAINER_OBJECT_BYTES
        is_sound = (object_type == LOG_CONTAINER) == (header_bytes == CONTAINER_OBJECT_BYTES)
        if is_container:
            contents = inflate(body, is_whole=is_whole)
        else:
            contents = Contents(header + body, is_sound=True, used_bytes=len(body))
        if not is_whole:
            counts.cut_off(f"byte {position}")
        elif not (contents.is_sound and is_sound):
            counts.reject(LogReject.DAMAGED, f"byte {position}")
        # Nor is the size of a damaged container to be trusted: look for the next one inside it.
        is_lost = not (is_whole and contents.is_sound)
        yield contents.data, not is_lost
        position += len(header) + contents.used_bytes if is_lost else object_bytes


def next_object(stream: BinaryIO, position: int, size_bytes: int, counts: LogCounts | None) -> int:
    """Return where the next object begins, ``size_bytes`` if there is none; count what had to be stepped over."""
    start, block_bytes = position, LONGEST_PADDING + len(OBJECT_MAGIC)  # as a rule it is near
    while True:
        stream.seek(position)
        block = stream.read(block_bytes)
        found = block.find(OBJECT_MAGIC)
        if found >= 0 or len(block) <= len(OBJECT_MAGIC):  # the end, perhaps earlier than it was
            break
        position += len(block) - len(OBJECT_MAGIC) + 1
        block_bytes = SEARCH_BYTES
    position = position + found if found >= 0 else size_bytes
    if counts is not None and position - start > LONGEST_PADDING:
        counts.reject(LogReject.DAMAGED, f"byte {start}")
    return position


class Contents(NamedTuple):
    """What a container holds."""

    data: bytes | bytearray
    is_sound: bool  # all of it, and the container holds nothing else
    used_bytes: int  # of the container's body; what follows was not looked at


NOTHING = Contents(b"", is_sound=False, used_bytes=0)


def inflate(body: bytes, *, is_whole: bool) -> Contents:
    """Return what a container holds.

    A container that the end of the file cuts gives its beginning. One with wrong bytes inside gives nothing: where
    they are is not known, and what they inflate to could pass for frames.
    """
    if len(body) < CONTAINER_HEADER.size:
        return NOTHING
    method, stated_bytes = CONTAINER_HEADER.unpack_from(body)
    payload = memoryview(body)[CONTAINER_HEADER.size :]
    if method == STORED:
        stored = bytes(payload[:stated_bytes])
        is_sound = stated_bytes <= len(payload) <= stated_bytes + LONGEST_PADDING
        return Contents(stored, is_sound, CONTAINER_HEADER.size + len(stored))
    if method == DEFLATED and is_whole and stated_bytes <= MAX_CONTAINER_BYTES:
        sound = sound_contents(payload, stated_bytes, LONGEST_PADDING)
        if sound is not None:
            return Contents(sound, is_sound=True, used_bytes=len(body))
    inflater = zlib.decompressobj()
    try:
        data = inflater.decompress(payload, MAX_CONTAINER_BYTES)
    except zlib.error:
        return NOTHING
    # Without its end the checksum was not compared, or there is too much of it to be a container.
    if method != DEFLATED or (not inflater.eof and (is_whole or inflater.unconsumed_tail)):
        return NOTHING
    foreign_bytes = len(inflater.unused_data)
    return Contents(data, inflater.eof and foreign_bytes <= LONGEST_PADDING, len(body) - foreign_bytes)
