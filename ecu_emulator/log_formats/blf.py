"""Vector's BLF format: CAN messages with nanosecond times in deflated containers."""

import struct
import zlib
from datetime import UTC, datetime
from typing import BinaryIO, Final

import numpy as np

from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.log_formats.base import US_PER_MS, US_PER_S, Header, Int64Array

FILE_HEADER: Final = struct.Struct("<4sL8BQQLL8H8H72x")
CONTAINER_HEADER: Final = struct.Struct("<4sHHLLH6xL4x")
OBJECT: Final = np.dtype([
    ("magic", "S4"), ("header_bytes", "<u2"), ("version", "<u2"), ("object_bytes", "<u4"), ("type", "<u4"),
    ("flags", "<u4"), ("client", "<u2"), ("object_version", "<u2"), ("time_ns", "<u8"),
    ("channel", "<u2"), ("message_flags", "u1"), ("length", "u1"), ("can_id", "<u4"), ("data", "u1", (8,)),
])  # fmt: skip
OBJECT_MAGIC: Final = b"LOBJ"
APPLICATION: Final = (5, 0, 0, 0, 2, 6, 8, 1)  # as python-can signs: application and format version
LOG_CONTAINER: Final = 10
DEFLATED: Final = 2
CAN_MESSAGE: Final = 1
ONE_NANOSECOND: Final = 2
CONTAINER_BYTES: Final = 128 * 1024
OBJECTS_PER_CONTAINER: Final = CONTAINER_BYTES // OBJECT.itemsize
NS_PER_US: Final = 1_000


class BlfWriter:
    """Writes what python-can's BLFWriter writes; the start of measurement is UTC, to the millisecond."""

    def __init__(self, stream: BinaryIO, header: Header) -> None:
        self._stream = stream
        self._start_us = header.start_us // US_PER_MS * US_PER_MS
        self._stop_us = self._start_us
        self._waiting = np.empty(0, OBJECT)
        self._objects = 0
        self._inflated_bytes = FILE_HEADER.size
        self._write_header(FILE_HEADER.size)

    def write(self, t_us: Int64Array, frames: EncodedFrames) -> None:
        """Append frames; ``t_us`` are their times in microseconds since the epoch."""
        objects = np.zeros(len(frames), OBJECT)
        objects["magic"] = OBJECT_MAGIC
        objects["header_bytes"] = OBJECT.fields["channel"][1] if OBJECT.fields else 0
        objects["version"] = 1
        objects["object_bytes"] = OBJECT.itemsize
        objects["type"] = CAN_MESSAGE
        objects["flags"] = ONE_NANOSECOND
        objects["time_ns"] = (t_us - self._start_us) * NS_PER_US
        objects["channel"] = 1
        objects["length"] = frames.length
        objects["can_id"] = frames.can_id  # bit 31 says extended here, too
        objects["data"] = frames.data
        self._waiting = np.concatenate((self._waiting, objects))
        while len(self._waiting) >= OBJECTS_PER_CONTAINER:
            self._write_container(OBJECTS_PER_CONTAINER)
        if len(t_us):
            self._stop_us = int(t_us[-1])

    def close(self) -> None:
        """Write the last container, then the sizes and times into the header."""
        if len(self._waiting):
            self._write_container(len(self._waiting))
        size_bytes = self._stream.tell()
        self._stream.seek(0)
        self._write_header(size_bytes)

    def _write_container(self, count: int) -> None:
        inflated = self._waiting[:count].tobytes()
        self._waiting = self._waiting[count:]
        deflated = zlib.compress(inflated)
        size_bytes = CONTAINER_HEADER.size + len(deflated)
        header = CONTAINER_HEADER.pack(OBJECT_MAGIC, 16, 1, size_bytes, LOG_CONTAINER, DEFLATED, len(inflated))
        self._stream.write(header + deflated + bytes(size_bytes % 4))
        self._objects += count
        self._inflated_bytes += CONTAINER_HEADER.size + len(inflated)

    def _write_header(self, size_bytes: int) -> None:
        times = (*_systemtime(self._start_us), *_systemtime(self._stop_us))
        self._stream.write(
            FILE_HEADER.pack(
                b"LOGG", FILE_HEADER.size, *APPLICATION, size_bytes, self._inflated_bytes, self._objects, 0, *times
            )
        )


def _systemtime(t_us: int) -> tuple[int, ...]:
    moment = datetime.fromtimestamp(t_us // US_PER_S, UTC)
    return (
        moment.year, moment.month, moment.isoweekday() % 7, moment.day, moment.hour, moment.minute, moment.second,
        t_us % US_PER_S // US_PER_MS,
    )  # fmt: skip
