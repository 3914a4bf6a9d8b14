"""Batches of frames: made of columns, or what a reader makes of a text or file that a test has in memory."""

import io
from collections.abc import Callable, Iterator
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from canlog.frames import FrameBatch, empty_batch, join
from canlog.logs.log_counts import LogCounts


def frames_at(
    t_ns: npt.ArrayLike,
    can_id: npt.ArrayLike,
    length: npt.ArrayLike = 8,
    data: npt.ArrayLike = 0,
    *,
    flags: npt.ArrayLike = 0,
    channel: npt.ArrayLike = 0,
) -> FrameBatch:
    """Return frames at these times; what is one number, all of them have; payloads have eight bytes or their own."""
    times, payloads = np.array(t_ns, np.int64), np.asarray(data, np.uint8)
    width = payloads.shape[-1] if payloads.ndim else 8
    small = (np.broadcast_to(np.asarray(one, np.uint8), times.shape).copy() for one in (length, flags, channel))
    return FrameBatch(
        t_ns=times,
        can_id=np.broadcast_to(np.asarray(can_id, np.uint32), times.shape).copy(),
        data=np.broadcast_to(payloads, (len(times), width)).copy(),
        **dict(zip(("length", "flags", "channel"), small, strict=True)),
    )


def read_whole(
    reader: Callable[[BinaryIO, LogCounts], Iterator[FrameBatch]], contents: bytes
) -> tuple[FrameBatch, LogCounts]:
    """Return all frames as one batch, an empty one if there are none, and what was counted."""
    counts = LogCounts()
    return join([*reader(io.BytesIO(contents), counts)] or [empty_batch()]), counts
