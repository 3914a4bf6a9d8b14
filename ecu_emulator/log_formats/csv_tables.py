"""Comma-separated logs: python-can's, with payloads in base64, and that of GVRET devices and SavvyCAN."""

from typing import BinaryIO, Final

import numpy as np

from ecu_emulator.frames import EncodedFrames
from ecu_emulator.log_formats import text
from ecu_emulator.log_formats.base import EXTENDED_FLAG, US_PER_S, Header, Int64Array, UInt8Array

TIME_DIGITS: Final = 16  # of microseconds since the epoch
BASE64_DIGITS: Final = np.frombuffer(b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/", np.uint8)


class CsvWriter:
    """Writes what python-can's CSVWriter writes: seconds since the epoch, to the microsecond."""

    def __init__(self, stream: BinaryIO, header: Header) -> None:
        del header  # nothing of it is in the file
        self._stream = stream
        self._stream.write(b"timestamp,arbitration_id,extended,remote,error,dlc,data\n")

    def write(self, t_us: Int64Array, frames: EncodedFrames) -> None:
        """Append frames; ``t_us`` are their times in microseconds since the epoch."""
        count = len(frames)
        is_extended = (frames.can_id & np.uint32(EXTENDED_FLAG)) != 0
        parts = [
            text.decimal(t_us // US_PER_S, 10),
            text.constant(".", count),
            text.decimal(t_us % US_PER_S, 6),
            text.constant(",0x", count),
            text.identifier(frames.can_id),
            text.when(is_extended, ",1"),
            text.when(~is_extended, ",0"),
            text.constant(",0,0,", count),
            text.decimal(frames.length.astype(np.int64), 1),
            text.constant(",", count),
            base64(frames.data, frames.length),
        ]
        self._stream.write(text.lines(parts))

    def close(self) -> None:
        """Nothing: the format has no end."""


class GvretWriter:
    """Writes what SavvyCAN saves as GVRET log: microseconds since the epoch, the bytes padded to eight columns."""

    def __init__(self, stream: BinaryIO, header: Header) -> None:
        del header  # nothing of it is in the file
        self._stream = stream
        self._stream.write(b"Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n")

    def write(self, t_us: Int64Array, frames: EncodedFrames) -> None:
        """Append frames; ``t_us`` are their times in microseconds since the epoch."""
        count = len(frames)
        is_extended = (frames.can_id & np.uint32(EXTENDED_FLAG)) != 0
        parts = [
            text.decimal(t_us, TIME_DIGITS),
            text.constant(",", count),
            text.identifier(frames.can_id, standard_digits=text.EXTENDED_ID_DIGITS),
            text.when(is_extended, ",true"),
            text.when(~is_extended, ",false"),
            text.constant(",Rx,0,", count),
            text.decimal(frames.length.astype(np.int64), 1),
            text.payload(frames.data, np.full(count, frames.data.shape[1], np.uint8), separator=","),
            text.constant(",", count),
        ]
        self._stream.write(text.lines(parts))

    def close(self) -> None:
        """Nothing: the format has no end."""


def base64(data: UInt8Array, length: UInt8Array) -> UInt8Array:
    """Return payloads (n, width) in base64, four characters for each three bytes or part of them."""
    rows, width = data.shape
    groups = -(-width // 3)
    padded = np.zeros((rows, groups, 3), np.int64)
    padded.reshape(rows, -1)[:, :width] = data
    bits = padded[..., 0] << 16 | padded[..., 1] << 8 | padded[..., 2]
    characters = BASE64_DIGITS[bits[..., None] >> np.array([18, 12, 6, 0]) & 0x3F].reshape(rows, -1)
    place = np.arange(4 * groups)
    # n bytes need 4 n / 3 characters, rounded up; the group is filled with "=".
    used = -(-4 * length.astype(np.int64) // 3)[:, None]
    whole = 4 * -(-length.astype(np.int64) // 3)[:, None]
    characters = np.where(place < used, characters, np.uint8(ord("=")))
    written: UInt8Array = np.where(place < whole, characters, text.DROPPED).astype(np.uint8)
    return written
