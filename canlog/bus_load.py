"""How long frames keep a bus busy: the one estimate for logs and live buses."""

from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, FrameBatch

# Bits of a frame (ISO 11898-1) in which five of a kind are followed by a stuff bit, payload apart.
CLASSIC_BITS: Final = 34.0  # start of frame, 11-bit identifier, control field, checksum
FD_BITS: Final = 22.0  # the same without the checksum, which has stuff bits of its own at fixed places
EXTENDED_BITS: Final = 20.0  # more with a 29-bit identifier
FD_EXTENDED_BITS: Final = 19.0
# And those without: delimiters, acknowledgement, end of frame, the space before the next one.
TAIL_BITS: Final = 13.0
FD_SHORT_CHECKSUM_BITS: Final = 27.0  # stuff count, 17 bits of checksum, fixed stuff bits: up to 16 bytes
FD_LONG_CHECKSUM_BITS: Final = 32.0  # 21 bits of checksum
FD_SHORT_BYTES: Final = 16
ERROR_BITS: Final = 23.0  # of an error frame at most: two flags, delimiter, space

# What recordings of five vehicles need, counted bit by bit: 0.06 to 0.11. Random payloads need 0.03; the most is 0.25.
STUFF_SHARE: Final = 0.1


def frame_bits(batch: FrameBatch) -> FloatArray:
    """Return the length of frames on the wire in bits at the arbitration rate, stuff bits estimated, shape (n,).

    The faster part of CAN FD frames with a bit rate switch is counted at the slower rate: an upper bound.
    """
    is_extended = (batch.can_id & np.uint32(EXTENDED_FLAG)) != 0
    is_fd = (batch.flags & np.uint8(FD_FLAG)) != 0
    payload = np.where(batch.can_id & np.uint32(REMOTE_FLAG), 0.0, 8.0 * batch.length)
    head = np.where(is_fd, FD_BITS, CLASSIC_BITS)
    head += np.where(is_extended, np.where(is_fd, FD_EXTENDED_BITS, EXTENDED_BITS), 0.0)
    fd_checksum = np.where(batch.length > FD_SHORT_BYTES, FD_LONG_CHECKSUM_BITS, FD_SHORT_CHECKSUM_BITS)
    tail = np.where(is_fd, TAIL_BITS + fd_checksum, TAIL_BITS)
    bits: FloatArray = (head + payload) * (1.0 + STUFF_SHARE) + tail
    return np.where(batch.can_id & np.uint32(ERROR_FLAG), ERROR_BITS, bits)
