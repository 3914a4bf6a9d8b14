"""Many CAN frames with one system call, straight into arrays; the standard library offers one at a time."""

import ctypes
import errno
import os
import socket
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from canlog.arrays import Int64Array, UInt8Array, UInt32Array
from canlog.frames import BRS_FLAG, ESI_FLAG, FD_FLAG, FD_PAYLOAD_BYTES, NS_PER_US, PAYLOAD_BYTES, FrameBatch
from canlog.jit import array_kernel
from canlog.live.raw_socket import SO_TIMESTAMPNS

SLOTS = 512  # frames per call
CLASSIC_BYTES = 16  # struct can_frame
FD_BYTES = 72  # struct canfd_frame
CONTROL_BYTES = 64  # one time stamp takes 32
NS_PER_S = 1_000_000_000

_CONTROL_WORDS = CONTROL_BYTES // 8  # length, level and type, seconds, nanoseconds
_STAMP = socket.SOL_SOCKET | SO_TIMESTAMPNS << 32  # level and type of a control message as one word


class _IoVector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _MessageHeader(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint32),
        ("vectors", ctypes.POINTER(_IoVector)),
        ("vector_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _Message(ctypes.Structure):
    _fields_ = (("header", _MessageHeader), ("received", ctypes.c_uint32))


@dataclass(frozen=True, slots=True, kw_only=True)
class Reception:
    """What one call brought: frames as columns, and how many there were that are neither CAN nor CAN FD."""

    batch: FrameBatch
    read: int  # all of them
    unsupported: int


class Slots(NamedTuple):
    """What the kernel filled in, one row per frame."""

    frames: UInt8Array  # (slots, 72)
    can_id: UInt32Array  # (slots,) the first bytes of those
    control: Int64Array  # (slots, 8)
    size: UInt32Array  # (slots,)
    control_length: Int64Array  # (slots,)


class SlotColumns(NamedTuple):
    """The same as columns, with room for all rows."""

    t_ns: Int64Array
    can_id: UInt32Array
    length: UInt8Array
    flags: UInt8Array
    data: UInt8Array


class FrameReceiver:
    """Preallocated slots that ``receive`` fills from a non-blocking raw CAN socket with SO_TIMESTAMPNS switched on."""

    def __init__(self, file_descriptor: int) -> None:
        self._vectors = (_IoVector * SLOTS)()
        self._messages = (_Message * SLOTS)()
        headers = np.frombuffer(memoryview(self._messages).cast("B"), np.uint8).reshape(SLOTS, ctypes.sizeof(_Message))
        frames = np.zeros((SLOTS, FD_BYTES), np.uint8)
        self._slots = Slots(
            frames=frames,
            can_id=frames.view(np.uint32)[:, 0],
            control=np.zeros((SLOTS, _CONTROL_WORDS), np.int64),
            size=headers[:, _Message.received.offset :][:, :4].view(np.uint32)[:, 0],
            control_length=headers[:, _MessageHeader.control_length.offset :][:, :8].view(np.int64)[:, 0],
        )
        self._slots.control_length[:] = CONTROL_BYTES
        for slot in range(SLOTS):
            self._vectors[slot] = _IoVector(self._slots.frames.ctypes.data + slot * FD_BYTES, FD_BYTES)
            header = self._messages[slot].header
            header.vectors = ctypes.pointer(self._vectors[slot])
            header.vector_count = 1
            header.control = self._slots.control.ctypes.data + slot * CONTROL_BYTES
        self._call = ctypes.CDLL(None, use_errno=True).recvmmsg
        self._arguments = (file_descriptor, ctypes.byref(self._messages), SLOTS, socket.MSG_DONTWAIT, None)
        self._reception(0)  # compiles now: the first frames must not wait for the compiler

    def receive(self) -> Reception:
        """Return what is waiting, at most ``SLOTS`` frames.

        Raises
        ------
        OSError
            As the kernel reports it, once all frames before the failure were returned or are still to be returned;
            also if a frame has no time.
        """
        while (count := self._call(*self._arguments)) < 0:
            number = ctypes.get_errno()
            if number == errno.EINTR:
                continue
            if number == errno.EAGAIN:
                return self._reception(0)
            raise OSError(number, os.strerror(number))
        return self._reception(count)

    def _reception(self, count: int) -> Reception:
        columns = SlotColumns(
            t_ns=np.empty(count, np.int64),
            can_id=np.empty(count, np.uint32),
            length=np.empty(count, np.uint8),
            flags=np.empty(count, np.uint8),
            data=np.zeros((count, FD_PAYLOAD_BYTES if has_fd(self._slots.size, count) else PAYLOAD_BYTES), np.uint8),
        )
        known = read_slots(self._slots, count, columns)
        if known < 0:
            raise OSError(errno.EPROTO, "the kernel delivered a frame without its time")
        batch = FrameBatch(**columns._asdict(), channel=np.zeros(count, np.uint8))
        return Reception(batch=batch if known == count else batch[:known], read=count, unsupported=count - known)


@array_kernel
def has_fd(size: UInt32Array, count: int) -> bool:
    """Return whether one of the frames is a CAN FD frame."""
    fd_count = 0
    for row in range(count):
        fd_count += size[row] == FD_BYTES
    return fd_count > 0


@array_kernel
def read_slots(slots: Slots, count: int, columns: SlotColumns) -> int:
    """Fill in the columns of the frames that are CAN or CAN FD; return how many are, -1 if one has no time.

    The slots are made ready for the next call: the kernel changes the lengths that it is given, and no stamp of these
    frames may pass for one of later frames.
    """
    known = 0
    has_times = True
    for row in range(count):
        has_time = slots.control[row, 1] == _STAMP
        slots.control[row, 1] = 0
        slots.control_length[row] = CONTROL_BYTES
        is_fd = slots.size[row] == FD_BYTES
        if not is_fd and slots.size[row] != CLASSIC_BYTES:
            continue
        if not has_time:
            has_times = False
            continue
        frame = slots.frames[row]
        # Whole microseconds, cut as candump cuts them: a live stream and its recording have identical times.
        micros = slots.control[row, 3] // NS_PER_US
        columns.t_ns[known] = slots.control[row, 2] * NS_PER_S + micros * NS_PER_US
        columns.can_id[known] = slots.can_id[row]
        length = min(frame[4], FD_PAYLOAD_BYTES if is_fd else PAYLOAD_BYTES)
        columns.length[known] = length
        # The byte of the flags is padding in a classic frame; past its length a sender may leave anything.
        columns.flags[known] = (frame[5] & (BRS_FLAG | ESI_FLAG)) | FD_FLAG if is_fd else 0
        for place in range(length):
            columns.data[known, place] = frame[8 + place]
        known += 1
    return known if has_times else -1
