"""AUTOSAR E2E profile 1, vectorised, for both ends of the wire.

CRC8 SAE J1850 (polynomial 0x1D) in byte 0 over the low byte of the data id, its high byte and bytes 1 to 7 (data id
mode BOTH); a counter in bits 8 to 11 that runs from 0 to 14. As the profile demands, start value and final
inversion of the CRC cancel out: the CRC is the bare polynomial remainder. It is therefore linear, and the CRC of a
payload is the exclusive or of one table entry per byte.
"""

from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from canlog.arrays import UInt8Array

IntegerArray = npt.NDArray[np.integer]

PAYLOAD_BYTES: Final = 8
COUNTER_PERIOD: Final = 15  # the values 0..14; 15 is not a counter
CRC_BYTE: Final = 0
COUNTER_BYTE: Final = 1
COUNTER_MASK: Final = 0x0F
DATA_START_BIT: Final = 12  # first bit that carries signals

_POLYNOMIAL: Final = 0x1D


def _shift_in_zeros(remainder: int) -> int:
    """Return the CRC remainder after eight more zero bits."""
    for _ in range(8):
        remainder <<= 1
        if remainder > 0xFF:
            remainder ^= 0x100 | _POLYNOMIAL
    return remainder


def _position_tables() -> UInt8Array:
    """Return what each value of each covered byte adds to the CRC, shape (9, 256).

    Rows 0 and 1 are the low and the high byte of the data id, row ``1 + k`` is payload byte k.
    """
    rows = [[_shift_in_zeros(value) for value in range(256)]]
    for _ in range(PAYLOAD_BYTES):
        rows.append([_shift_in_zeros(remainder) for remainder in rows[-1]])
    return np.array(rows[::-1], np.uint8)


CRC_TABLES: Final = _position_tables()
"""What each value of each covered byte adds to the CRC, as ``_position_tables`` says; for compiled loops."""

_BYTE_ROWS: Final = np.arange(2, PAYLOAD_BYTES + 1)


@cache
def data_id_remainder(data_id: int) -> int:
    """Return the part of the CRC that comes from a data id, 0..255.

    Raises ValueError if the data id does not fit 16 bits.
    """
    if not 0 <= data_id <= 0xFFFF:
        raise ValueError(f"a data id has 16 bits, got {data_id:#x}")
    return int(CRC_TABLES[0, data_id & 0xFF] ^ CRC_TABLES[1, data_id >> 8])


def crc(data: UInt8Array, id_remainder: UInt8Array | int) -> UInt8Array:
    """Return the CRC of each payload, shape (n,).

    Parameters
    ----------
    data : (n, 8) array
        Payloads; byte 0 is not covered.
    id_remainder : (n,) array or int
        ``data_id_remainder`` of each payload or of all.
    """
    remainder: UInt8Array = np.bitwise_xor.reduce(CRC_TABLES[_BYTE_ROWS, data[:, 1:]], axis=1)
    return remainder ^ np.asarray(id_remainder, np.uint8)


def protect(data: UInt8Array, data_id: int, counter: IntegerArray) -> UInt8Array:
    """Return the payloads with counter and CRC filled in, shape (n, 8).

    Parameters
    ----------
    data : (n, 8) array
        Payloads whose bits below ``DATA_START_BIT`` are ignored.
    data_id : int
        Data id of the message, 16 bits.
    counter : (n,) array
        Transmission numbers, >= 0; taken modulo ``COUNTER_PERIOD``.
    """
    protected = data.copy()
    protected[:, COUNTER_BYTE] &= ~np.uint8(COUNTER_MASK)
    protected[:, COUNTER_BYTE] |= (counter % COUNTER_PERIOD).astype(np.uint8)
    protected[:, CRC_BYTE] = crc(protected, data_id_remainder(data_id))
    return protected


def crc_is_valid(data: UInt8Array, id_remainder: UInt8Array | int) -> npt.NDArray[np.bool_]:
    """Return whether the CRC in byte 0 fits each payload, shape (n,); arguments as ``crc``."""
    valid: npt.NDArray[np.bool_] = data[:, CRC_BYTE] == crc(data, id_remainder)
    return valid


def counter_of(data: UInt8Array) -> UInt8Array:
    """Return the counter of each payload, shape (n,); 15 is not a valid one."""
    return data[:, COUNTER_BYTE] & np.uint8(COUNTER_MASK)
