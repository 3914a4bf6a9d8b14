"""Many CAN frames with one system call, straight into arrays; the standard library offers one at a time."""

import ctypes
import errno
import os
import socket
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from diag_service.frames import BRS_FLAG, ESI_FLAG, FD_FLAG, FD_PAYLOAD_BYTES, PAYLOAD_BYTES, FrameBatch
from diag_service.records import UInt8Array
from diag_service.sources.columns import NS_PER_US, clear_padding

SLOTS = 256  # frames per call
CLASSIC_BYTES = 16  # struct can_frame
FD_BYTES = 72  # struct canfd_frame
CONTROL_BYTES = 64  # one time stamp takes 32
SO_TIMESTAMPNS = 35
NS_PER_S = 1_000_000_000

_FRAME = np.dtype(
    {
        "names": ["can_id", "length", "flags", "data"],
        "formats": ["<u4", "u1", "u1", ("u1", (FD_PAYLOAD_BYTES,))],
        "offsets": [0, 4, 5, 8],
        "itemsize": FD_BYTES,
    }
)
_CONTROL = np.dtype(
    {
        "names": ["level", "type", "seconds", "nanoseconds"],
        "formats": ["<i4", "<i4", "<i8", "<i8"],
        "offsets": [8, 12, 16, 24],
        "itemsize": CONTROL_BYTES,
    }
)


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


class FrameReceiver:
    """Preallocated slots that ``receive`` fills from a non-blocking raw CAN socket with SO_TIMESTAMPNS switched on."""

    def __init__(self, file_descriptor: int) -> None:
        self._file_descriptor = file_descriptor
        self._frames = np.zeros(SLOTS, _FRAME)
        self._control = np.zeros(SLOTS, _CONTROL)
        self._vectors = (_IoVector * SLOTS)()
        self._messages = (_Message * SLOTS)()
        self._headers = np.frombuffer(memoryview(self._messages).cast("B"), np.uint8).reshape(
            SLOTS, ctypes.sizeof(_Message)
        )
        for slot in range(SLOTS):
            self._vectors[slot] = _IoVector(self._frames.ctypes.data + slot * FD_BYTES, FD_BYTES)
            header = self._messages[slot].header
            header.vectors = ctypes.pointer(self._vectors[slot])
            header.vector_count = 1
            header.control = self._control.ctypes.data + slot * CONTROL_BYTES
            header.control_length = CONTROL_BYTES
        self._fresh_headers = self._headers.copy()  # the kernel overwrites the lengths of what it fills
        self._call = ctypes.CDLL(None, use_errno=True).recvmmsg

    def receive(self) -> Reception | None:
        """Return what is waiting, at most SLOTS frames; None if there is nothing.

        Raises
        ------
        OSError
            As the kernel reports it, once all frames before the failure were returned or are still to be read.
        """
        self._headers[:] = self._fresh_headers
        self._control["level"] = -1  # no stamp of an earlier frame may pass for one of these
        while (count := self._receive_once()) < 0:
            number = ctypes.get_errno()
            if number == errno.EINTR:
                continue
            if number == errno.EAGAIN:
                return None
            raise OSError(number, os.strerror(number))
        return self._reception(count)

    def _receive_once(self) -> int:
        return int(self._call(self._file_descriptor, self._messages, SLOTS, socket.MSG_DONTWAIT, None))

    def _reception(self, count: int) -> Reception:
        offset = _Message.received.offset
        size = self._headers[:count, offset : offset + 4].copy().view(np.uint32)[:, 0]
        is_fd = size == FD_BYTES
        known = is_fd | (size == CLASSIC_BYTES)
        frames, control, is_fd = self._frames[:count][known], self._control[:count][known], is_fd[known]
        stamped = (control["level"] == socket.SOL_SOCKET) & (control["type"] == SO_TIMESTAMPNS)
        if not stamped.all():
            raise OSError(errno.EPROTO, "the kernel delivered a frame without its time")
        width = FD_PAYLOAD_BYTES if is_fd.any() else PAYLOAD_BYTES
        length = np.minimum(frames["length"], np.where(is_fd, FD_PAYLOAD_BYTES, PAYLOAD_BYTES)).astype(np.uint8)
        # Whole microseconds, cut as candump cuts them: a live stream and its recording have identical times.
        micros = control["nanoseconds"] // NS_PER_US
        return Reception(
            batch=FrameBatch(
                t_ns=control["seconds"] * NS_PER_S + micros * NS_PER_US,
                can_id=frames["can_id"].astype(np.uint32),
                length=length,
                data=clear_padding(frames["data"][:, :width], length),
                flags=frame_flags(frames["flags"], is_fd),
            ),
            read=count,
            unsupported=count - len(frames),
        )


def frame_flags(kernel_flags: UInt8Array, is_fd: npt.NDArray[np.bool_]) -> UInt8Array:
    """Return the flags of each frame; the byte is padding in a classic one."""
    return np.where(is_fd, kernel_flags & np.uint8(BRS_FLAG | ESI_FLAG) | np.uint8(FD_FLAG), np.uint8(0))
