"""What faults do to frames: each a pure function of the frames and of which of them it strikes.

Frames come in the order of time and may leave in another one; whoever calls puts them in order.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray
from canlog.e2e.profile1 import COUNTER_PERIOD, CRC_BYTE, PAYLOAD_BYTES, counter_of, protect
from ecu_emulator.bus.frames import EncodedFrames

Rows = npt.NDArray[np.int64]

ERROR_FLAG: Final = 0x2000_0000  # SocketCAN's CAN_ERR_FLAG
ERROR_ID: Final = ERROR_FLAG | 0x88  # CAN_ERR_PROT, CAN_ERR_BUSERROR: a violation of the protocol
STUFF_ERROR_DATA: Final = (0, 0, 4, 0, 0, 0, 0, 0)  # CAN_ERR_PROT_STUFF in byte 2
SHORT_BYTES: Final = 4
FRAME_S: Final = 111.0 / 500e3  # eight bytes, standard identifier, no stuff bits: the most frames that 500 kbit/s carry
FOREIGN_IDS: Final = (0x500, 0x5FF)  # none of the wire contract's, and below all of them in priority


def chosen(frames: EncodedFrames, rows: Rows | npt.NDArray[np.bool_]) -> EncodedFrames:
    """Return some of the frames."""
    return EncodedFrames(
        t_s=frames.t_s[rows], can_id=frames.can_id[rows], length=frames.length[rows], data=frames.data[rows]
    )


def joined(first: EncodedFrames, second: EncodedFrames) -> EncodedFrames:
    """Return the frames of both, one after the other."""
    return EncodedFrames(
        t_s=np.concatenate((first.t_s, second.t_s)),
        can_id=np.concatenate((first.can_id, second.can_id)),
        length=np.concatenate((first.length, second.length)),
        data=np.concatenate((first.data, second.data)),
    )


def without(frames: EncodedFrames, rows: Rows) -> EncodedFrames:
    """Return the frames that are left."""
    return chosen(frames, np.delete(np.arange(len(frames)), rows))


def postponed(frames: EncodedFrames, rows: Rows, by_s: FloatArray | float) -> EncodedFrames:
    """Return the frames, those in ``rows`` later by ``by_s``, shape (len(rows),) or one number."""
    t_s = frames.t_s.copy()
    t_s[rows] += by_s
    return EncodedFrames(t_s=t_s, can_id=frames.can_id, length=frames.length, data=frames.data)


def duplicated(frames: EncodedFrames, rows: Rows) -> EncodedFrames:
    """Return the frames and a copy of those in ``rows``, next on the bus."""
    copies = chosen(frames, rows)
    return joined(frames, postponed(copies, np.arange(len(rows)), FRAME_S))


def with_bad_crc(frames: EncodedFrames, rows: Rows) -> EncodedFrames:
    """Return the frames, the CRC of those in ``rows`` inverted."""
    data = frames.data.copy()
    data[rows, CRC_BYTE] ^= 0xFF
    return EncodedFrames(t_s=frames.t_s, can_id=frames.can_id, length=frames.length, data=data)


def shortened(frames: EncodedFrames, rows: Rows) -> EncodedFrames:
    """Return the frames, those in ``rows`` cut to ``SHORT_BYTES``."""
    data, length = frames.data.copy(), frames.length.copy()
    data[rows, SHORT_BYTES:] = 0
    length[rows] = SHORT_BYTES
    return EncodedFrames(t_s=frames.t_s, can_id=frames.can_id, length=length, data=data)


def recounted(frames: EncodedFrames, rows: Rows, data_id: int, counter: Rows) -> EncodedFrames:
    """Return the frames, those in ``rows``, of one message, with other counters, shape (len(rows),), and sound CRCs."""
    data = frames.data.copy()
    data[rows] = protect(data[rows], data_id, counter % COUNTER_PERIOD)
    return EncodedFrames(t_s=frames.t_s, can_id=frames.can_id, length=frames.length, data=data)


def counters(frames: EncodedFrames, rows: Rows) -> Rows:
    """Return the alive counters of the frames in ``rows``."""
    return counter_of(frames.data[rows]).astype(np.int64)


def error_frames(t_s: FloatArray) -> EncodedFrames:
    """Return error frames at these times."""
    count = len(t_s)
    return EncodedFrames(
        t_s=t_s,
        can_id=np.full(count, ERROR_ID, np.uint32),
        length=np.full(count, PAYLOAD_BYTES, np.uint8),
        data=np.tile(np.array(STUFF_ERROR_DATA, np.uint8), (count, 1)),
    )


def foreign_frames(t_s: FloatArray, random: np.random.Generator) -> EncodedFrames:
    """Return frames of nobody's interest at these times."""
    count = len(t_s)
    drawn = random.integers(0, 2**64, (count, 2), np.uint64)  # whole words: the draws do not depend on their batches
    first, last = FOREIGN_IDS
    return EncodedFrames(
        t_s=t_s,
        can_id=(first + drawn[:, 0] % np.uint64(last - first + 1)).astype(np.uint32),
        length=np.full(count, PAYLOAD_BYTES, np.uint8),
        data=np.ascontiguousarray(drawn[:, 1]).view(np.uint8).reshape(-1, PAYLOAD_BYTES),
    )


def crowded(
    own_s: FloatArray, free_s: float, until_s: float, load_ratio: float
) -> tuple[FloatArray, FloatArray, float]:
    """Return when own and foreign frames are sent on a bus whose idle time foreign frames fill.

    Parameters
    ----------
    own_s : (n,) array
        When own frames are ready, in order; they win every arbitration, but wait for the frame on the bus.
    free_s, until_s : float
        When the bus becomes free, and up to when foreign frames want it.
    load_ratio : float
        Share of the bit rate that is used: 1 leaves no gap.

    Returns
    -------
    tuple
        Send times of own (n,) and foreign frames (m,), and when the bus becomes free again.
    """
    sent_s = np.empty_like(own_s)
    foreign_s = []
    row = 0
    while row < len(own_s) or free_s < until_s:
        if row < len(own_s) and (own_s[row] <= free_s or free_s >= until_s):
            sent_s[row] = max(free_s, float(own_s[row]))
            free_s = sent_s[row] + FRAME_S
            row += 1
        else:
            foreign_s.append(free_s)
            free_s += FRAME_S / load_ratio
    return sent_s, np.array(foreign_s), free_s
