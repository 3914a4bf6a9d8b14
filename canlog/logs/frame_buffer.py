"""Columns that compiled readers fill row by row."""

from typing import NamedTuple

import numpy as np

from canlog.arrays import Int64Array, UInt8Array, UInt32Array
from canlog.frames import FD_FLAG, FD_PAYLOAD_BYTES, PAYLOAD_BYTES, FrameBatch
from canlog.logs.word_kernels import UInt64Array

LEAST_HANDED_OVER = 0.75  # of a buffer: what is not used of it is kept as long as the batch


class FrameRows(NamedTuple):
    """The columns of a buffer, as kernels take them: a row per frame."""

    t_ns: Int64Array
    can_id: UInt32Array
    length: UInt8Array
    flags: UInt8Array
    channel: UInt8Array
    data: UInt8Array  # (rows, 8), or (rows, 64) once a longer payload was met
    words: UInt64Array  # the same memory as words of eight bytes, (rows, 1) or (rows, 8)


def new_rows(count: int, width: int) -> FrameRows:
    """Return columns with anything in them."""
    data = np.empty((count, width), np.uint8)
    return FrameRows(
        t_ns=np.empty(count, np.int64),
        can_id=np.empty(count, np.uint32),
        length=np.empty(count, np.uint8),
        flags=np.empty(count, np.uint8),
        channel=np.empty(count, np.uint8),
        data=data,
        words=data.view(np.uint64),
    )


def rows_of(batch: FrameBatch) -> FrameRows:
    """Return frames as kernels take them."""
    plain = batch.plain()
    flags, words = np.require(plain.flags, np.uint8, ("C", "W")), plain.data.view(np.uint64)
    return FrameRows(plain.t_ns, plain.can_id, plain.length, flags, plain.channel, plain.data, words)


class FrameBuffer:
    """Columns that are reused for every block: freshly mapped memory is slow."""

    def __init__(self, count: int) -> None:
        self.rows = new_rows(count, PAYLOAD_BYTES)

    def reserve(self, count: int, used: int) -> None:
        """Make room for at least this many frames; what was in rows past those in use is lost."""
        if len(self.rows.t_ns) < count:
            larger = new_rows(count + used, self.rows.data.shape[1])
            for name in FrameRows._fields:
                getattr(larger, name)[:used] = getattr(self.rows, name)[:used]
            self.rows = larger

    def widen(self, used: int) -> None:
        """Make room for payloads of CAN FD, from now on."""
        data = np.empty((len(self.rows.t_ns), FD_PAYLOAD_BYTES), np.uint8)
        data[:used] = 0
        data[:used, : self.rows.data.shape[1]] = self.rows.data[:used]
        self.rows = self.rows._replace(data=data, words=data.view(np.uint64))

    def batch(self, count: int) -> FrameBatch:
        """Return a copy of the first rows, no wider than they need."""
        return self._batch(count, is_copied=True)

    def handed_over(self, count: int) -> FrameBatch:
        """Return the first rows as ``batch`` does, without a copy if they are most of the buffer: it gets new ones."""
        if count < LEAST_HANDED_OVER * len(self.rows.t_ns):
            return self.batch(count)
        batch = self._batch(count, is_copied=False)
        self.rows = new_rows(*self.rows.data.shape)
        return batch

    def _batch(self, count: int, *, is_copied: bool) -> FrameBatch:
        rows, width = self.rows, self.rows.data.shape[1]
        if width > PAYLOAD_BYTES and not (rows.flags[:count] & np.uint8(FD_FLAG)).any():
            width = PAYLOAD_BYTES
        return FrameBatch(
            t_ns=np.array(rows.t_ns[:count], copy=is_copied),
            can_id=np.array(rows.can_id[:count], copy=is_copied),
            length=np.array(rows.length[:count], copy=is_copied),
            data=np.array(rows.data[:count, :width], copy=is_copied or width < rows.data.shape[1]),
            flags=np.array(rows.flags[:count], copy=is_copied),
            channel=np.array(rows.channel[:count], copy=is_copied),
        )
