"""PCAN's trace format, version 2.1: milliseconds from the start with three decimals, the start in days since 1899."""

from typing import BinaryIO, Final

import numpy as np

from ecu_emulator.frames import EncodedFrames
from ecu_emulator.log_formats import text
from ecu_emulator.log_formats.base import US_PER_MS, Header, Int64Array

BUS_NUMBER: Final = 1
US_PER_DAY: Final = 86_400_000_000
DAYS_TO_EPOCH: Final = 25_569  # from 1899-12-30 to 1970-01-01
FRACTION_DIGITS: Final = 14  # of a day: finer than a microsecond
NUMBER_DIGITS: Final = 7


class TrcWriter:
    """Writes what python-can's TRCWriter writes; the start counts as UTC, as it does there."""

    def __init__(self, stream: BinaryIO, header: Header) -> None:
        self._stream = stream
        self._start_us = header.start_us
        self._count = 0
        lines = (
            ";$FILEVERSION=2.1",
            f";$STARTTIME={_days(self._start_us)}",
            ";$COLUMNS=N,O,T,B,I,d,R,L,D",
            ";",
            ";   Message   Time    Type    ID     Rx/Tx",
            ";   Number    Offset  |  Bus  [hex]  |  Reserved",
            ";   |         [ms]    |  |    |      |  |  Data Length Code",
            ";   |         |       |  |    |      |  |  |    Data [hex] ...",
            ";---+-- ------+------ +- +- --+----- +- +- +--- +- -- -- -- -- -- -- --",
        )
        self._stream.write("".join(f"{line}\r\n" for line in lines).encode())

    def write(self, t_us: Int64Array, frames: EncodedFrames) -> None:
        """Append frames; ``t_us`` are their times in microseconds since the epoch."""
        count = len(frames)
        elapsed_us = t_us - self._start_us
        number = self._count + 1 + np.arange(count, dtype=np.int64)
        parts = [
            text.aligned(number, NUMBER_DIGITS + 3),
            text.constant(" ", count),
            text.aligned(elapsed_us // US_PER_MS, 12),
            text.constant(".", count),
            text.decimal(elapsed_us % US_PER_MS, 3),
            text.constant(f" DT {BUS_NUMBER:>2} ", count),
            text.identifier(frames.can_id, standard_digits=4),
            text.constant(" Rx -  ", count),
            text.decimal(frames.length.astype(np.int64), 1),
            text.constant("   ", count),
            text.payload(frames.data, frames.length, separator=" "),
            text.constant("\r", count),
        ]
        self._stream.write(text.lines(parts))
        self._count += count

    def close(self) -> None:
        """Nothing: the format has no end."""


def _days(start_us: int) -> str:
    """Return the start in days since 1899-12-30, exact to the microsecond."""
    days, rest_us = divmod(start_us, US_PER_DAY)
    fraction = round(rest_us * 10**FRACTION_DIGITS / US_PER_DAY)
    return f"{DAYS_TO_EPOCH + days}.{fraction:0{FRACTION_DIGITS}d}"
