"""The objects inside BLF containers: located one by one, their fields read in bulk."""

import struct
from dataclasses import dataclass

import numpy as np

from diag_service.frames import ERROR_FLAG, PAYLOAD_BYTES, REMOTE_FLAG, FrameBatch, empty_batch
from diag_service.records import Int64Array, UInt8Array
from diag_service.sources.columns import clear_padding, rounded_to_us
from diag_service.sources.tally import LogReject, Tally

OBJECT_MAGIC = b"LOBJ"
OBJECT_HEADER = struct.Struct("<4sHHLL")  # magic, header size, header version, object size, object type
FLAGS_OFFSET = 16  # behind the common header, in both header versions
TIME_OFFSET = 24
STAMPED_HEADER_BYTES = 32
TEN_MICROSECONDS = 1  # flag: unit of the time; anything else is nanoseconds
LONGEST_PADDING = 8
MAX_OBJECT_BYTES = 4 * 1024 * 1024  # a damaged size must not swallow the rest of the file
NS_PER_US = 1_000
NS_PER_TEN_US = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Where the fields of a frame object are, counted from the end of its header; -1: it has none."""

    length: int = -1
    remote: int = -1
    remote_mask: int = 0
    fd: int = -1
    fd_mask: int = 0
    data: int = -1
    is_error: bool = False

    @property
    def size(self) -> int:
        """Bytes that must be there."""
        return max(self.data, 0)


CAN_ID_OFFSET = 4
MESSAGE = Layout(length=3, remote=2, remote_mask=0x80, data=8)
FD_MESSAGE = Layout(length=3, remote=2, remote_mask=0x80, fd=13, fd_mask=0x01, data=20)
FD_MESSAGE_64 = Layout(length=1, remote=12, remote_mask=0x10, fd=13, fd_mask=0x10, data=40)
ERROR = Layout(is_error=True)
LAYOUTS = {1: MESSAGE, 86: MESSAGE, 100: FD_MESSAGE, 101: FD_MESSAGE_64, 2: ERROR, 73: ERROR, 104: ERROR}


class ObjectStream:
    """Objects of successive containers, which may be cut anywhere, to batches of frames."""

    def __init__(self, start_us: int, tally: Tally) -> None:
        self._start_ns = start_us * NS_PER_US
        self._tally = tally
        self._tail = b""  # the beginning of an object that the next container continues
        self._number = 0  # objects seen, for messages
        self._is_lost = False

    def feed(self, data: bytes) -> FrameBatch:
        """Return the frames of the objects that end in this piece."""
        data = self._tail + data
        found: list[tuple[int, int, int, int]] = []  # position, header size, object size, type
        position = 0
        while (position := self._seek(data, position)) + OBJECT_HEADER.size <= len(data):
            _, header_bytes, _, object_bytes, kind = OBJECT_HEADER.unpack_from(data, position)
            if not OBJECT_HEADER.size <= object_bytes <= MAX_OBJECT_BYTES:
                self._reject(LogReject.DAMAGED)
                self._is_lost = True
                position += len(OBJECT_MAGIC)
                continue
            if position + object_bytes > len(data):
                break
            self._number += 1
            layout = LAYOUTS.get(kind)
            if layout is None:
                self._tally.skipped += 1
            elif header_bytes < STAMPED_HEADER_BYTES or object_bytes < header_bytes + layout.size:
                self._reject(LogReject.DAMAGED)
            else:
                found.append((position, header_bytes, object_bytes, kind))
            position += object_bytes
        self._tail = data[position:]
        return self._frames(data, np.array(found, np.int64)) if found else empty_batch()

    def lose_track(self) -> None:
        """Forget an object whose continuation is missing; go on with the next one that can be found."""
        self._tail = b""
        self._is_lost = True

    def finish(self) -> None:
        """Count an object that the file does not complete."""
        if self._tail.strip(b"\0"):
            self._tally.truncated = True
            self._reject(LogReject.CUT_OFF)

    def _seek(self, data: bytes, position: int) -> int:
        """Return the position of the next object; at most a few bytes of padding lie before a sound one."""
        found = data.find(OBJECT_MAGIC, position)
        if found < 0:
            is_padding = not data[position:].strip(b"\0")
            return len(data) if is_padding else max(position, len(data) - len(OBJECT_MAGIC) + 1)
        if found - position > LONGEST_PADDING and not self._is_lost:
            self._reject(LogReject.DAMAGED)
        self._is_lost = False
        return found

    def _reject(self, reason: LogReject) -> None:
        self._tally.reject(reason, f"object {self._number + 1}")

    def _frames(self, data: bytes, found: Int64Array) -> FrameBatch:
        """Return the frames of located objects (n, 4), in their order; CAN FD is counted and left out."""
        # Eight bytes more, for a payload shorter than what is gathered may end the buffer.
        raw = np.frombuffer(data + bytes(PAYLOAD_BYTES), np.uint8)
        position, header_bytes, object_bytes, kind = found.T
        can_id = np.zeros(len(found), np.uint32)
        length = np.zeros(len(found), np.int64)
        payload = np.zeros((len(found), PAYLOAD_BYTES), np.uint8)
        is_classic = np.ones(len(found), np.bool_)
        for number in np.unique(kind):
            layout, rows = LAYOUTS[int(number)], np.flatnonzero(kind == number)
            body = position[rows] + header_bytes[rows]
            if layout.is_error:
                can_id[rows] = ERROR_FLAG
                continue
            remote = (raw[body + layout.remote] & layout.remote_mask) != 0
            can_id[rows] = gather(raw, body + CAN_ID_OFFSET, 4).view(np.uint32)[:, 0]
            can_id[rows] |= np.where(remote, np.uint32(REMOTE_FLAG), np.uint32(0))
            length[rows] = np.minimum(raw[body + layout.length], PAYLOAD_BYTES)
            stored = np.where(remote, 0, object_bytes[rows] - header_bytes[rows] - layout.data)
            payload[rows] = clear_padding(
                gather(raw, body + layout.data, PAYLOAD_BYTES), np.minimum(length[rows], stored)
            )
            if layout.fd >= 0:
                is_classic[rows] = (raw[body + layout.fd] & layout.fd_mask) == 0
        self._tally.reject(LogReject.CAN_FD, f"up to object {self._number}", int(np.count_nonzero(~is_classic)))
        return FrameBatch(
            t_ns=self._times_ns(raw, position)[is_classic],
            can_id=can_id[is_classic],
            length=length[is_classic].astype(np.uint8),
            data=payload[is_classic],
        )

    def _times_ns(self, raw: UInt8Array, position: Int64Array) -> Int64Array:
        unit = gather(raw, position + FLAGS_OFFSET, 4).view(np.uint32)[:, 0]
        count = gather(raw, position + TIME_OFFSET, 8).view(np.int64)[:, 0]
        elapsed_ns = count * np.where(unit == TEN_MICROSECONDS, NS_PER_TEN_US, 1)
        return rounded_to_us(self._start_ns + elapsed_ns)


def gather(raw: UInt8Array, position: Int64Array, size: int) -> UInt8Array:
    """Return ``size`` bytes from each position, shape (n, size)."""
    return np.ascontiguousarray(raw[position[:, None] + np.arange(size)])
