"""The unit in which a log counts time, where it does not say: told by the load that a bus can have."""

import numpy as np

from canlog.arrays import FloatArray
from canlog.frames import EXTENDED_FLAG, FD_FLAG, FrameBatch
from canlog.logs.columns.roles import MICROSECONDS, MILLISECONDS, SECONDS

# Least bits of a frame (ISO 11898-1): no stuff bits, payload apart.
STANDARD_BITS, EXTENDED_BITS, BITS_PER_BYTE = 47, 67, 8
FASTEST_BIT_US = 1.0  # 1 Mbit/s
FASTEST_FD_BIT_US = 0.125  # 8 Mbit/s, of the payload of a CAN FD frame
MOST_LOAD_RATIO = 2.0  # adapters that stamp frames by the packet may show more than one for a moment
LEAST_FRAMES = 10
UNIT_NAMES = {MICROSECONDS: "microseconds", MILLISECONDS: "milliseconds", SECONDS: "seconds"}


def bus_load_ratio(batch: FrameBatch) -> float:
    """Return the least load of the busiest channel at the fastest bit rates; infinite where time stands still.

    0 for a channel with too few frames to tell.
    """
    return max((_load_ratio(batch[batch.channel == channel]) for channel in np.unique(batch.channel)), default=0.0)


def is_plausible(load_ratio: float) -> bool:
    """Return whether a bus can have such a load."""
    return load_ratio <= MOST_LOAD_RATIO


def likely_unit(batch: FrameBatch) -> tuple[int, list[str]]:
    """Return the unit of times that were read as microseconds, and what is to be said of it.

    The finest unit with which the load is plausible; where it is with none, they stay microseconds.
    """
    load_ratio = bus_load_ratio(batch)
    for unit in (MICROSECONDS, MILLISECONDS, SECONDS):
        if is_plausible(load_ratio / 10**unit):
            if unit == MICROSECONDS:
                return unit, []
            note = (
                f"times are taken as {UNIT_NAMES[unit]}, not microseconds: a bus of 1 Mbit/s would have a load of "
                f"{100 * load_ratio:.0f} %"
            )
            return unit, [note]
    return MICROSECONDS, []


def _load_ratio(batch: FrameBatch) -> float:
    if len(batch) < LEAST_FRAMES:
        return 0.0
    span_us = float(batch.t_ns.max() - batch.t_ns.min()) / 1e3
    busy_us = float(_least_us(batch)[1:].sum())
    return busy_us / span_us if span_us else float("inf")


def _least_us(batch: FrameBatch) -> FloatArray:
    overhead = np.where(batch.can_id & np.uint32(EXTENDED_FLAG), EXTENDED_BITS, STANDARD_BITS) * FASTEST_BIT_US
    is_fd = (batch.flags & np.uint8(FD_FLAG)) != 0
    bit_us = np.where(is_fd, FASTEST_FD_BIT_US, FASTEST_BIT_US)
    least_us: FloatArray = np.where(is_fd, STANDARD_BITS / 2.0, overhead) + BITS_PER_BYTE * bit_us * batch.length
    return least_us
