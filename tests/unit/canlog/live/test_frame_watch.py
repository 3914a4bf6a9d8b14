"""Whether frames say something new: watched bits that change, first frames, error frames; nothing else."""

import struct

import numpy as np

from canlog.arrays import UInt8Array
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, WatchedBits
from canlog.live.frame_watch import FrameWatch, see_news, watch_for

GEAR = WatchedBits(can_id=0x120, mask=0x8000_07FF, payload=b"\x00\x0f")
GROUP = WatchedBits(can_id=0x18F0_0500 | EXTENDED_FLAG, mask=0x03FF_FF00 | EXTENDED_FLAG, payload=b"\xff")


def slots(*frames: tuple[int, bytes]) -> UInt8Array:
    """Return frames as the kernel lays them out, in slots of a CAN FD frame."""
    rows = [struct.pack("=IB3x64s", can_id, len(payload), payload) for can_id, payload in frames]
    return np.frombuffer(bytearray(b"".join(rows)), np.uint8).reshape(len(rows), 72)


def says_new(watch: FrameWatch, *frames: tuple[int, bytes]) -> bool:
    return see_news(slots(*frames), 0, len(frames), watch)


def test_a_watched_bit_that_changes_is_news_once() -> None:
    watch = watch_for([GEAR])
    assert says_new(watch, (0x120, b"\x00\x03"))  # nothing was known before
    assert not says_new(watch, (0x120, b"\x00\x03"), (0x120, b"\x00\x03"))
    assert says_new(watch, (0x120, b"\x00\x03"), (0x120, b"\x00\x04"), (0x120, b"\x00\x04"))
    assert not says_new(watch, (0x120, b"\x00\x04"))


def test_a_change_there_and_back_is_news() -> None:
    watch = watch_for([GEAR])
    says_new(watch, (0x120, b"\x00\x03"))
    assert says_new(watch, (0x120, b"\x00\x04"), (0x120, b"\x00\x03"))


def test_other_bits_and_other_frames_are_none() -> None:
    watch = watch_for([GEAR])
    says_new(watch, (0x120, b"\x00\x03"))
    assert not says_new(watch, (0x120, b"\xff\xf3\xff"), (0x121, b"\x00\x05"), (0x120 | EXTENDED_FLAG, b"\x00\x05"))


def test_a_parameter_group_is_watched_whoever_sends_it() -> None:
    watch = watch_for([GEAR, GROUP])
    says_new(watch, (0x120, b"\x00\x03"), (0x0CF0_0511 | EXTENDED_FLAG, b"\x01"))
    assert not says_new(watch, (0x18F0_0522 | EXTENDED_FLAG, b"\x01\x77"))
    assert says_new(watch, (0x18F0_0522 | EXTENDED_FLAG, b"\x02"))


def test_an_error_frame_is_always_news() -> None:
    for watch in (watch_for([]), watch_for([GEAR])):
        assert says_new(watch, (ERROR_FLAG | 0x40, b"\x00"))
        assert not says_new(watch, (0x700, b"\x00"))


def test_only_the_rows_that_are_meant_are_looked_at() -> None:
    watch, frames = watch_for([GEAR]), slots((0x120, b"\x00\x01"), (0x120, b"\x00\x01"), (0x120, b"\x00\x02"))
    assert see_news(frames, 0, 1, watch)
    assert not see_news(frames, 1, 2, watch)
    assert see_news(frames, 2, 3, watch)
