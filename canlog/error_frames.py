"""What a CAN controller says of its bus in error frames, as Linux words them (linux/can/error.h)."""

from collections import Counter
from enum import StrEnum
from typing import Final

import numpy as np

from canlog.arrays import BoolArray
from canlog.frames import ERROR_FLAG, FrameBatch


class BusTrouble(StrEnum):
    """A kind of trouble on the bus; one error frame may tell of several."""

    BUS_OFF = "bus_off"
    RESTARTED = "restarted"
    ERROR_PASSIVE = "error_passive"
    ERROR_WARNING = "error_warning"
    ERROR_ACTIVE = "error_active"  # the counters have fallen again: all is well
    ARBITRATION_LOST = "arbitration_lost"
    PROTOCOL = "protocol"
    NO_ACKNOWLEDGE = "no_acknowledge"
    TRANSCEIVER = "transceiver"
    TRANSMIT_TIMEOUT = "transmit_timeout"
    CONTROLLER_OVERFLOW = "controller_overflow"
    OTHER = "other"


_CONTROLLER: Final = 0x04  # class "controller": byte 1 says what about it
_CLASSES: Final = {
    BusTrouble.TRANSMIT_TIMEOUT: 0x01,
    BusTrouble.ARBITRATION_LOST: 0x02,
    BusTrouble.PROTOCOL: 0x08 | 0x80,  # protocol violation, bus error
    BusTrouble.TRANSCEIVER: 0x10,
    BusTrouble.NO_ACKNOWLEDGE: 0x20,
    BusTrouble.BUS_OFF: 0x40,
    BusTrouble.RESTARTED: 0x100,
}
_CONTROLLER_STATES: Final = {
    BusTrouble.CONTROLLER_OVERFLOW: 0x01 | 0x02,  # receive, transmit
    BusTrouble.ERROR_WARNING: 0x04 | 0x08,
    BusTrouble.ERROR_PASSIVE: 0x10 | 0x20,
    BusTrouble.ERROR_ACTIVE: 0x40,
}
GOOD_NEWS: Final = frozenset({BusTrouble.RESTARTED, BusTrouble.ERROR_ACTIVE})


def is_error(batch: FrameBatch) -> BoolArray:
    """Return which frames are error frames, shape (n,)."""
    found: BoolArray = (batch.can_id & np.uint32(ERROR_FLAG)) != 0
    return found


def reports(batch: FrameBatch, error: BusTrouble) -> BoolArray:
    """Return which frames are error frames that tell of ``error``, shape (n,)."""
    found = is_error(batch)
    if error in _CLASSES:
        found &= (batch.can_id & np.uint32(_CLASSES[error])) != 0
    elif error in _CONTROLLER_STATES:
        found &= (batch.can_id & np.uint32(_CONTROLLER)) != 0
        found &= (batch.data[:, 1] & np.uint8(_CONTROLLER_STATES[error])) != 0
    else:
        for known in (*_CLASSES, *_CONTROLLER_STATES):
            found &= ~reports(batch, known)
    return found


def count_errors(batch: FrameBatch) -> Counter[BusTrouble]:
    """Return how many error frames of a batch tell of each kind of trouble; kinds that do not occur are left out."""
    if not is_error(batch).any():
        return Counter()
    return Counter({error: count for error in BusTrouble if (count := int(reports(batch, error).sum()))})
