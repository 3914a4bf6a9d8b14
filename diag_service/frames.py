"""FrameBatch: the one columnar type that every source yields."""

from dataclasses import dataclass

import numpy as np

from diag_service.records import Int64Array, UInt8Array, UInt32Array

EXTENDED_FLAG = 0x8000_0000  # bit 31 of ``can_id``: 29-bit identifier
REMOTE_FLAG = 0x4000_0000
ERROR_FLAG = 0x2000_0000
PAYLOAD_BYTES = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameBatch:
    """Frames in the order of arrival, as arrays; no Python object per frame.

    ``t_ns`` is bus time in whole microseconds (what a candump log keeps), so a live stream and its recording decode
    to the same bits. Payload bytes past ``length`` are zero.
    """

    t_ns: Int64Array  # (n,)
    can_id: UInt32Array  # (n,) with the flags above
    length: UInt8Array  # (n,)
    data: UInt8Array  # (n, 8)

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, rows: slice) -> "FrameBatch":
        return FrameBatch(
            t_ns=self.t_ns[rows], can_id=self.can_id[rows], length=self.length[rows], data=self.data[rows]
        )


def empty_batch() -> FrameBatch:
    """Return a batch without frames."""
    return FrameBatch(
        t_ns=np.empty(0, np.int64),
        can_id=np.empty(0, np.uint32),
        length=np.empty(0, np.uint8),
        data=np.empty((0, PAYLOAD_BYTES), np.uint8),
    )
