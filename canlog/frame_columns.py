"""Small operations on columns of frames that several sources share."""

from collections.abc import Sequence

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import COLUMNS, FrameBatch

NS_PER_US = 1_000


def join(batches: Sequence[FrameBatch]) -> FrameBatch:
    """Return one batch with the frames of all, in their order, as wide as the widest."""
    if len(batches) == 1:
        return batches[0]
    width = max(batch.width for batch in batches)
    batches = [batch.widened(width) for batch in batches]
    return FrameBatch(**{name: np.concatenate([getattr(batch, name) for batch in batches]) for name in COLUMNS})


def clear_padding(data: UInt8Array, length: UInt8Array | Int64Array) -> UInt8Array:
    """Return payloads (n, width) with zeros past their length: a sender may leave anything there."""
    return np.where(np.arange(data.shape[1]) < length[:, None], data, 0).astype(np.uint8)


def rounded_to_us(t_ns: Int64Array) -> Int64Array:
    """Return times rounded to whole microseconds, still in nanoseconds."""
    return (t_ns + NS_PER_US // 2) // NS_PER_US * NS_PER_US
