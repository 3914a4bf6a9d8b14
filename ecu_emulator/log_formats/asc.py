"""Vector's ASC format: times in microseconds from the start, which is local time without a zone, to the millisecond."""

from datetime import datetime
from typing import BinaryIO, Final

import numpy as np

from ecu_emulator.frames import EncodedFrames
from ecu_emulator.log_formats import text
from ecu_emulator.log_formats.base import EXTENDED_FLAG, US_PER_MS, US_PER_S, Header, Int64Array

CHANNEL_NUMBER: Final = 1
# Not strftime's: the format's names are English in every locale.
DAYS: Final = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")
MONTHS: Final = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")


class AscWriter:
    """Writes what python-can's ASCWriter writes."""

    def __init__(self, stream: BinaryIO, header: Header) -> None:
        self._stream = stream
        self._start_us = header.start_us // US_PER_MS * US_PER_MS
        date = _date(self._start_us)
        self._stream.write(
            f"date {date}\nbase hex  timestamps absolute\ninternal events logged\n"
            f"Begin Triggerblock {date}\n   0.000000 Start of measurement\n".encode()
        )

    def write(self, t_us: Int64Array, frames: EncodedFrames) -> None:
        """Append frames; ``t_us`` are their times in microseconds since the epoch."""
        count = len(frames)
        elapsed_us = t_us - self._start_us
        parts = [
            text.decimal(elapsed_us // US_PER_S, 7),
            text.constant(".", count),
            text.decimal(elapsed_us % US_PER_S, 6),
            text.constant(f" {CHANNEL_NUMBER}  ", count),
            text.identifier(frames.can_id),
            text.when((frames.can_id & np.uint32(EXTENDED_FLAG)) != 0, "x"),
            text.constant("             Rx   d ", count),
            text.decimal(frames.length.astype(np.int64), 1),
            text.payload(frames.data, frames.length, separator=" "),
        ]
        self._stream.write(text.lines(parts))

    def close(self) -> None:
        """Write the end of the trigger block."""
        self._stream.write(b"End TriggerBlock\n")


def _date(start_us: int) -> str:
    start = datetime.fromtimestamp(start_us // US_PER_S).astimezone()
    milliseconds = start_us % US_PER_S // US_PER_MS
    day, month = DAYS[start.weekday()], MONTHS[start.month - 1]
    return f"{day} {month} {start.day:02d} {start:%H:%M:%S}.{milliseconds:03d} {start.year:04d}"
