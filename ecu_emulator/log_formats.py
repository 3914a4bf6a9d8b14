"""Frames into log files, faster than real time: candump, BLF or MF4, whole or not at all.

python-can's ``can_logconvert`` makes ASC, TRC and CSV of a candump log.
"""

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, Final, Protocol

import can
import numpy as np

from canlog.arrays import Int64Array
from canlog.files import is_plain_file, is_there, replacing
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, PAYLOAD_BYTES
from clutchdiag_io.command_line import STANDARD_STREAM
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.bus.sender import to_messages
from ecu_emulator.errors import LogFormatExtraError, RecordError

US_PER_S: Final = 1_000_000
US_PER_MS: Final = 1_000
MS_PER_S: Final = 1_000
NS_PER_US: Final = 1_000


class FrameWriter(Protocol):
    """Writes frames in one format to a stream; scenario time 0 is ``start_us`` since the epoch."""

    def __init__(self, stream: BinaryIO, start_us: int, channel: str) -> None: ...

    def write(self, frames: EncodedFrames) -> None:
        """Append frames, their times rounded to whole microseconds.

        Raises OSError if nobody takes them, RecordError if the format has no error frames.
        """

    def close(self) -> None:
        """Write what the format needs at its end."""


def _elapsed_us(frames: EncodedFrames) -> Int64Array:
    """Return the scenario times of frames in whole microseconds, shape (n,)."""
    return np.rint(frames.t_s * US_PER_S).astype(np.int64)


class CandumpWriter:
    """Writes what ``candump -L`` prints and canplayer plays: ``(1767225600.000000) vcan0 0A0#1122334455667788``."""

    def __init__(self, stream: BinaryIO, start_us: int, channel: str) -> None:
        self._stream, self._start_us, self._channel = stream, start_us, channel

    def write(self, frames: EncodedFrames) -> None:
        lines = list[str]()
        t_us = self._start_us + _elapsed_us(frames)
        columns = zip(t_us.tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data, strict=True)
        for frame_us, can_id, length, data in columns:
            digits = 8 if can_id & (EXTENDED_FLAG | ERROR_FLAG) else 3
            identifier, payload = f"{can_id & (EXTENDED_FLAG - 1):0{digits}X}", data[:length].tobytes().hex().upper()
            time = f"{frame_us // US_PER_S:010d}.{frame_us % US_PER_S:06d}"
            lines.append(f"({time}) {self._channel} {identifier}#{payload}\n")
        self._stream.write("".join(lines).encode())
        self._stream.flush()

    def close(self) -> None:
        """Write nothing: the format has no end."""


class BlfWriter:
    """Writes BLF by python-can; the start of measurement is UTC, to the millisecond."""

    def __init__(self, stream: BinaryIO, start_us: int, _channel: str) -> None:
        self._writer = can.BLFWriter(stream)
        self._start_ms, self._rest_us = divmod(start_us, US_PER_MS)
        # Floats of seconds since the epoch are 0.2 us apart: until the end times count from the start of measurement.
        self._writer.start_timestamp = 0.0

    def write(self, frames: EncodedFrames) -> None:
        elapsed_s = (self._rest_us + _elapsed_us(frames)) / US_PER_S + 0.5e-9  # the writer cuts what is below 1 ns
        for message in to_messages(replace(frames, t_s=elapsed_s)):
            self._writer.on_message_received(message)

    def close(self) -> None:
        """Write the last container, then the sizes and times into the header; closes the stream."""
        self._writer.start_timestamp = self._start_ms / MS_PER_S
        self._writer.stop_timestamp = self._writer.start_timestamp + (self._writer.stop_timestamp or 0.0)
        self._writer.stop()


FRAME: Final = np.dtype([
    ("CAN_DataFrame.BusChannel", "<u1"),
    ("CAN_DataFrame.ID", "<u4"),
    ("CAN_DataFrame.IDE", "<u1"),
    ("CAN_DataFrame.DLC", "<u1"),
    ("CAN_DataFrame.DataLength", "<u1"),
    ("CAN_DataFrame.DataBytes", "<u1", (PAYLOAD_BYTES,)),
    ("CAN_DataFrame.Dir", "<u1"),
    ("CAN_DataFrame.EDL", "<u1"),
    ("CAN_DataFrame.BRS", "<u1"),
    ("CAN_DataFrame.ESI", "<u1"),
])  # fmt: skip
VERSION: Final = "4.10"
TRANSPOSED_AND_DEFLATED: Final = 2
BUS_CHANNEL: Final = 1


class Mf4Writer:
    """Writes what python-can's MF4Writer writes, in columns; times are float seconds from the start.

    Raises
    ------
    LogFormatExtraError
        If asammdf is not installed.
    """

    def __init__(self, stream: BinaryIO, start_us: int, _channel: str) -> None:
        try:
            import asammdf  # noqa: PLC0415 - optional, and takes a second to import
            from asammdf.blocks import v4_constants  # noqa: PLC0415
            from asammdf.blocks.v4_blocks import SourceInformation  # noqa: PLC0415
        except ImportError as exc:
            raise LogFormatExtraError("MF4 needs asammdf: pip install '.[mf4]' in the checkout") from exc
        self._stream = stream
        self._signal: Any = asammdf.Signal
        self._source: Any = SourceInformation(source_type=v4_constants.SOURCE_BUS, bus_type=v4_constants.BUS_TYPE_CAN)
        self._mdf: Any = asammdf.MDF(version=VERSION)
        self._mdf.header.start_time = datetime.fromtimestamp(start_us / US_PER_S, UTC)
        self._has_group = False

    def write(self, frames: EncodedFrames) -> None:
        if np.any(frames.can_id & np.uint32(ERROR_FLAG)):
            raise RecordError("error frames are written to candump and BLF logs only")
        samples = np.zeros(len(frames), FRAME)
        samples["CAN_DataFrame.BusChannel"] = BUS_CHANNEL
        samples["CAN_DataFrame.ID"] = frames.can_id & np.uint32(EXTENDED_FLAG - 1)
        samples["CAN_DataFrame.IDE"] = (frames.can_id & np.uint32(EXTENDED_FLAG)) != 0
        samples["CAN_DataFrame.DLC"] = frames.length
        samples["CAN_DataFrame.DataLength"] = frames.length
        samples["CAN_DataFrame.DataBytes"] = frames.data
        elapsed_s = _elapsed_us(frames) / US_PER_S
        if self._has_group:
            self._mdf.extend(0, [(elapsed_s, None), (samples, None)])
        else:
            signal = self._signal(name="CAN_DataFrame", samples=samples, timestamps=elapsed_s, source=self._source)
            self._mdf.append(signal)
            self._has_group = True

    def close(self) -> None:
        """Write the file: MDF is assembled at the end."""
        try:
            self._mdf.save(self._stream, compression=TRANSPOSED_AND_DEFLATED)
        finally:
            self._mdf.close()


DEFAULT_START_NS: Final = 1_767_225_600_000_000_000  # 2026-01-01T00:00:00Z
LAST_START_NS: Final = 9_000_000_000_000_000_000  # the year 2255; ten digits of seconds, 64 bits of nanoseconds


class RecordFormat(StrEnum):
    """The log formats that can be written."""

    CANDUMP = "candump"
    BLF = "blf"
    MF4 = "mf4"


_FORMAT_OF_SUFFIX: Final[Mapping[str, RecordFormat]] = MappingProxyType(
    {".log": RecordFormat.CANDUMP, ".blf": RecordFormat.BLF, ".mf4": RecordFormat.MF4}
)
_WRITERS: Final[Mapping[RecordFormat, type[FrameWriter]]] = MappingProxyType(
    {RecordFormat.CANDUMP: CandumpWriter, RecordFormat.BLF: BlfWriter, RecordFormat.MF4: Mf4Writer}
)


@contextmanager
def open_log(
    path: Path, *, log_format: RecordFormat | None = None, start_ns: int = DEFAULT_START_NS, channel: str = "vcan0"
) -> Iterator[FrameWriter]:
    """Write a log while the block runs; if that ends with an exception, a file that was there before stays.

    Parameters
    ----------
    path : Path
        Where the file shall be; its suffix names the format unless ``log_format`` does. ``-`` is standard output, onto
        which candump alone is written.
    log_format : RecordFormat
        The format, whatever the suffix says.
    start_ns : int
        Time since the epoch [ns] of scenario time 0; the same drive gives the same file.
    channel : str
        The interface's name, for the format that keeps it (candump).

    Raises
    ------
    RecordError
        If the format is not known, asammdf is missing for MF4, the file cannot be created, or the disk is full or no
        longer takes data.
    """
    if not 0 <= start_ns <= LAST_START_NS:
        raise RecordError(f"start of the log out of range: {start_ns} ns since 1970")
    if not channel or any(character.isspace() for character in channel):
        raise RecordError(f"not a channel name: {channel!r}")
    start_us = start_ns // NS_PER_US
    if path == STANDARD_STREAM:
        if log_format not in {None, RecordFormat.CANDUMP}:
            raise RecordError(f"{log_format} is written to files only: its beginning is written last")
        yield CandumpWriter(sys.stdout.buffer, start_us, channel)
        return
    log_format = log_format or _FORMAT_OF_SUFFIX.get(path.suffix.lower())
    if log_format is None:
        known = ", ".join(f"{suffix} ({name})" for suffix, name in _FORMAT_OF_SUFFIX.items())
        raise RecordError(f"{path}: no log format has the suffix {path.suffix!r}; there are {known}")
    if is_there(path) and not is_plain_file(path):
        raise RecordError(f"cannot write {path}: not a regular file")
    with replacing(path, RecordError) as part:
        with part.open("wb") as stream:
            log = _WRITERS[log_format](stream, start_us, channel)
            yield log
            log.close()
        part.replace(path)
