"""Whether frames say something new, told from a few bits of theirs: a look that costs next to nothing."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from canlog.arrays import BoolArray, UInt8Array, UInt32Array
from canlog.frames import ERROR_FLAG, WatchedBits
from canlog.jit import array_kernel, inlined_kernel

PAYLOAD_BYTE = 8  # of struct can_frame and struct canfd_frame


class FrameWatch(NamedTuple):
    """What is watched of k messages, and what was last seen of it."""

    can_id: UInt32Array  # (k,)
    mask: UInt32Array  # (k,)
    payload_mask: UInt8Array  # (k, bytes)
    payload: UInt8Array  # (k, bytes) as masked
    is_seen: BoolArray  # (k,)


def watch_for(watched: Sequence[WatchedBits]) -> FrameWatch:
    """Return a watch that has not seen anything yet."""
    width = max((len(one.payload) for one in watched), default=0)
    mask = np.frombuffer(b"".join(one.payload.ljust(width, b"\0") for one in watched), np.uint8)
    return FrameWatch(
        can_id=np.array([one.can_id & one.mask for one in watched], np.uint32),
        mask=np.array([one.mask for one in watched], np.uint32),
        payload_mask=mask.reshape(len(watched), width).copy(),
        payload=np.zeros((len(watched), width), np.uint8),
        is_seen=np.zeros(len(watched), np.bool_),
    )


@inlined_kernel
def identifier(frame: UInt8Array) -> int:
    """Return the identifier of a frame as the kernel lays it out, with its flags."""
    return int(
        np.uint32(frame[0])
        | np.uint32(frame[1]) << np.uint32(8)
        | np.uint32(frame[2]) << np.uint32(16)
        | np.uint32(frame[3]) << np.uint32(24)
    )


@array_kernel
def see_news(frames: UInt8Array, first: int, stop: int, watch: FrameWatch) -> bool:
    """Look at frames ``first <= row < stop``; return whether a watched bit changed or an error frame is among them."""
    is_new = False
    for row in range(first, stop):
        can_id = identifier(frames[row])
        if can_id & ERROR_FLAG:
            is_new = True
        for number in range(watch.can_id.size):
            if can_id & watch.mask[number] == watch.can_id[number]:
                is_new |= note_payload(frames[row], number, watch)
    return is_new


@array_kernel
def note_payload(frame: UInt8Array, number: int, watch: FrameWatch) -> bool:
    """Take the watched bits of a frame for those last seen; return whether they are others than before."""
    is_new = not watch.is_seen[number]
    watch.is_seen[number] = True
    for place in range(watch.payload_mask.shape[1]):
        bits = frame[PAYLOAD_BYTE + place] & watch.payload_mask[number, place]
        is_new |= bits != watch.payload[number, place]
        watch.payload[number, place] = bits
    return is_new
