"""Columns that compiled readers fill row by row, and the lines of text to fill them from."""

import codecs
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from canlog.arrays import Int64Array, UInt8Array, UInt32Array
from canlog.frames import FD_FLAG, FD_PAYLOAD_BYTES, PAYLOAD_BYTES, FrameBatch
from canlog.logs.word_kernels import UInt64Array

BLOCK_BYTES = 2 * 1024 * 1024
MAX_LINE_BYTES = 4096  # whatever is longer is not text
BYTE_ORDER_MARK = codecs.BOM_UTF8  # some editors and converters put it before a text
LEAST_HANDED_OVER = 0.75  # of an arena: what is not used of it is kept as long as the batch


@dataclass(slots=True, kw_only=True)
class Arena:
    """Arrays with a row per frame, reused for every block: freshly mapped memory is slow."""

    t_ns: Int64Array
    can_id: UInt32Array
    length: UInt8Array
    flags: UInt8Array
    channel: UInt8Array
    data: UInt8Array  # (rows, 8), or (rows, 64) once a longer payload was met

    @classmethod
    def of(cls, rows: int, width: int = PAYLOAD_BYTES) -> "Arena":
        """Return an arena for this many frames."""
        return cls(
            t_ns=np.empty(rows, np.int64),
            can_id=np.empty(rows, np.uint32),
            length=np.empty(rows, np.uint8),
            flags=np.empty(rows, np.uint8),
            channel=np.empty(rows, np.uint8),
            data=np.empty((rows, width), np.uint8),
        )

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def data_words(self) -> UInt64Array:
        """The payloads as words of eight bytes, shape (rows, 1) or (rows, 8)."""
        return self.data.view(np.uint64)

    def reserve(self, rows: int, rows_in_use: int = 0) -> None:
        """Make room for at least this many frames; what was in rows past those in use is lost."""
        if len(self) < rows:
            larger = Arena.of(rows + rows_in_use, self.data.shape[1])
            for name in self.__slots__:
                column = getattr(larger, name)
                column[:rows_in_use] = getattr(self, name)[:rows_in_use]
                setattr(self, name, column)

    def widen(self, rows_in_use: int) -> None:
        """Make room for payloads of CAN FD, from now on."""
        data = np.empty((len(self), FD_PAYLOAD_BYTES), np.uint8)
        data[:rows_in_use] = 0
        data[:rows_in_use, : self.data.shape[1]] = self.data[:rows_in_use]
        self.data = data

    def batch(self, count: int) -> FrameBatch:
        """Return a copy of the first rows, no wider than they need."""
        return self._rows(count, is_copied=True)

    def handed_over(self, count: int) -> FrameBatch:
        """Return the first rows as ``batch`` does, without a copy if they are most of the arena: it gets new arrays."""
        if count < LEAST_HANDED_OVER * len(self):
            return self.batch(count)
        batch = self._rows(count, is_copied=False)
        fresh = Arena.of(len(self), self.data.shape[1])
        for name in self.__slots__:
            setattr(self, name, getattr(fresh, name))
        return batch

    def _rows(self, count: int, *, is_copied: bool) -> FrameBatch:
        is_classic = self.data.shape[1] == PAYLOAD_BYTES or not (self.flags[:count] & np.uint8(FD_FLAG)).any()
        width = PAYLOAD_BYTES if is_classic else FD_PAYLOAD_BYTES
        return FrameBatch(
            t_ns=np.array(self.t_ns[:count], copy=is_copied),
            can_id=np.array(self.can_id[:count], copy=is_copied),
            length=np.array(self.length[:count], copy=is_copied),
            data=np.array(self.data[:count, :width], copy=is_copied or width < self.data.shape[1]),
            flags=np.array(self.flags[:count], copy=is_copied),
            channel=np.array(self.channel[:count], copy=is_copied),
        )


@dataclass(frozen=True, slots=True)
class Lines:
    """Whole lines of a log, each ended by a newline; the text is valid until the next ones are asked for."""

    text: UInt8Array
    is_terminated: bool = True  # False: one last line to which the newline was added, the file may have cut it


def lines_of(stream: BinaryIO) -> Iterator[Lines]:
    """Yield a text in blocks of whole lines, about 2 MiB each, and last what follows the last newline.

    A byte-order mark before the first one is passed over. Of a line that is too long to be one only the end is passed
    on, behind a NUL that makes it malformed.
    """
    buffer = bytearray(BLOCK_BYTES + MAX_LINE_BYTES)
    kept, is_first = 0, True
    while got := _fill(stream, memoryview(buffer)[kept:]):
        stop = kept + got
        if is_first and buffer.startswith(BYTE_ORDER_MARK):
            stop -= len(BYTE_ORDER_MARK)
            buffer[:stop] = buffer[len(BYTE_ORDER_MARK) : stop + len(BYTE_ORDER_MARK)]
        is_first = False
        end = buffer.rfind(b"\n", kept, stop) + 1
        if end:
            yield Lines(np.frombuffer(memoryview(buffer).toreadonly(), np.uint8, end))
        rest = buffer[end:stop]
        if len(rest) > MAX_LINE_BYTES:
            rest = bytearray(b"\0")
        kept = len(rest)
        buffer[:kept] = rest
    if buffer[:kept].strip():
        yield Lines(np.frombuffer(bytes(buffer[:kept]) + b"\n", np.uint8), is_terminated=False)


def _fill(stream: BinaryIO, view: memoryview) -> int:
    """Read until the view is full or the stream at its end, and return how much: a stream may come in small pieces."""
    count = 0
    while count < len(view) and (got := stream.readinto(view[count:])):  # type: ignore[attr-defined]  # of every one
        count += got
    return count


def end_of_line(text: UInt8Array, at: int) -> int:
    """Return the position behind the newline that ends a line."""
    step = 128
    while True:
        found = text[at : at + step].tobytes().find(b"\n")
        if found >= 0:
            return at + found + 1
        at, step = at + step, MAX_LINE_BYTES
