"""candump's log format, to the microsecond: ``(1767225600.000000) vcan0 0A0#1122334455667788``."""

from typing import BinaryIO

from ecu_emulator.frames import EncodedFrames
from ecu_emulator.log_formats import text
from ecu_emulator.log_formats.base import US_PER_S, Header, Int64Array


class CandumpWriter:
    """Writes what ``candump -L`` prints and canplayer plays."""

    def __init__(self, stream: BinaryIO, header: Header) -> None:
        self._stream = stream
        self._channel = header.channel

    def write(self, t_us: Int64Array, frames: EncodedFrames) -> None:
        """Append frames; ``t_us`` are their times in microseconds since the epoch."""
        count = len(frames)
        parts = [
            text.constant("(", count),
            text.decimal(t_us // US_PER_S, 10),
            text.constant(".", count),
            text.decimal(t_us % US_PER_S, 6),
            text.constant(f") {self._channel} ", count),
            text.identifier(frames.can_id),
            text.constant("#", count),
            text.payload(frames.data, frames.length),
        ]
        self._stream.write(text.lines(parts))

    def close(self) -> None:
        """Nothing: the format has no end."""
