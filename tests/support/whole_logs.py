"""What a reader makes of a whole text or file that a test has in memory."""

import io
from collections.abc import Callable, Iterator
from typing import BinaryIO

from canlog.frames import FrameBatch, empty_batch, join
from canlog.logs.log_counts import LogCounts


def read_whole(
    reader: Callable[[BinaryIO, LogCounts], Iterator[FrameBatch]], contents: bytes
) -> tuple[FrameBatch, LogCounts]:
    """Return all frames as one batch, an empty one if there are none, and what was counted."""
    counts = LogCounts()
    return join([*reader(io.BytesIO(contents), counts)] or [empty_batch()]), counts
