"""Frames as a table of Arrow, without any database."""

from typing import Any

import numpy as np

from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, FrameBatch
from canlog.parquet_file import TIME_TYPE, arrow_schema, load_pyarrow
from canlog.tables.layouts import BARE_ID

KINDS = {
    "time": TIME_TYPE,
    "channel": "uint8",
    "id": "uint32",
    **dict.fromkeys(("is_extended", "is_remote", "is_error", "is_fd"), "bool"),
    "data": "binary",
}


def frame_table(frames: FrameBatch) -> Any:  # noqa: ANN401 - an untyped library
    """Return a row per frame: time, channel, identifier, what kind of frame it is, and its bytes."""
    arrow = load_pyarrow()
    ends = np.concatenate(([0], np.cumsum(frames.length, dtype=np.int64)))
    sent = frames.data[np.arange(frames.width) < frames.length[:, np.newaxis]]
    data = arrow.LargeBinaryArray.from_buffers(
        arrow.large_binary(), len(frames), [None, arrow.py_buffer(ends), arrow.py_buffer(sent)]
    )
    flags = [(frames.can_id & np.uint32(flag)) != 0 for flag in (EXTENDED_FLAG, REMOTE_FLAG, ERROR_FLAG)]
    columns = [
        arrow.array(frames.t_ns, arrow.timestamp("ns", "UTC")),
        frames.channel,
        frames.can_id & np.uint32(BARE_ID),
        *flags,
        (frames.flags & FD_FLAG) != 0,
        data.cast(arrow.binary()),
    ]
    return arrow.table(columns, schema=arrow_schema(KINDS))
