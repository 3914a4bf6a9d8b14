"""Frames into log files, faster than real time: candump, BLF, ASC, MF4, TRC or CSV, whole or not at all."""

import os
import struct
import zlib
from abc import ABC, abstractmethod
from base64 import b64encode
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, Final, Protocol, Self

import numpy as np

from canlog.arrays import Int64Array
from canlog.files import replacing
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, PAYLOAD_BYTES
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.errors import LogFormatExtraError, RecordError

US_PER_S: Final = 1_000_000
US_PER_MS: Final = 1_000


@dataclass(frozen=True, slots=True, kw_only=True)
class LogHeader:
    """What a log says once."""

    start_us: int  # since the epoch: scenario time 0
    channel: str


class FrameWriter(Protocol):
    """Writes frames in one format; made with the header, ended by ``close``, which leaves the stream open."""

    def __init__(self, stream: BinaryIO, header: LogHeader) -> None: ...

    def write(self, t_us: Int64Array, frames: EncodedFrames) -> None:
        """Append frames; ``t_us`` are their times in microseconds since the epoch."""

    def close(self) -> None:
        """Write what the format needs at its end."""


US_PER_DAY: Final = 86_400_000_000
DAYS_TO_EPOCH: Final = 25_569  # from 1899-12-30 to 1970-01-01
# Not strftime's: the format's names are English in every locale.
DAYS: Final = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")
MONTHS: Final = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")


class _TextWriter(ABC):
    """Writes a line for each frame; the formats say which, and what comes before and behind all of them."""

    def __init__(self, stream: BinaryIO, header: LogHeader) -> None:
        self._stream = stream
        self._channel, self._start_us = header.channel, header.start_us
        self._count = 0
        self._stream.write(self._begin().encode())

    def write(self, t_us: Int64Array, frames: EncodedFrames) -> None:
        columns = zip(t_us.tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data, strict=True)
        lines = list[str]()
        for frame_us, can_id, length, data in columns:
            self._count += 1
            lines.append(self._line(frame_us, can_id, data[:length].tobytes()))
        self._stream.write("".join(lines).encode())

    def close(self) -> None:
        """Hand on what is still buffered; most formats have no end."""
        self._stream.flush()

    def _begin(self) -> str:
        return ""

    @abstractmethod
    def _line(self, t_us: int, can_id: int, payload: bytes) -> str:
        """Return what is written of a frame."""


def _identifier(can_id: int, standard_digits: int = 3) -> str:
    """Return an identifier as three or another number of hexadecimal digits, eight if extended or of an error frame."""
    digits = 8 if can_id & (EXTENDED_FLAG | ERROR_FLAG) else standard_digits
    return f"{can_id & (EXTENDED_FLAG - 1):0{digits}X}"


def _bytes_behind(separator: str, payload: bytes) -> str:
    return separator + payload.hex(separator).upper() if payload else ""


def _seconds(t_us: int) -> str:
    return f"{t_us // US_PER_S}.{t_us % US_PER_S:06d}"


class CandumpWriter(_TextWriter):
    """Writes what ``candump -L`` prints and canplayer plays: ``(1767225600.000000) vcan0 0A0#1122334455667788``."""

    def _line(self, t_us: int, can_id: int, payload: bytes) -> str:
        return f"({_seconds(t_us):0>17}) {self._channel} {_identifier(can_id)}#{payload.hex().upper()}\n"


class AscWriter(_TextWriter):
    """Writes Vector's ASC: times from the start, which is local time without a zone, to the millisecond.

    python-can's writer puts the moment of writing there, so that the same drive would not give the same file.
    """

    def _begin(self) -> str:
        self._start_us = self._start_us // US_PER_MS * US_PER_MS
        start = datetime.fromtimestamp(self._start_us // US_PER_S).astimezone()
        milliseconds = self._start_us % US_PER_S // US_PER_MS
        day, month = DAYS[start.weekday()], MONTHS[start.month - 1]
        date = f"{day} {month} {start.day:02d} {start:%H:%M:%S}.{milliseconds:03d} {start.year:04d}"
        return (
            f"date {date}\nbase hex  timestamps absolute\ninternal events logged\n"
            f"Begin Triggerblock {date}\n   0.000000 Start of measurement\n"
        )

    def _line(self, t_us: int, can_id: int, payload: bytes) -> str:
        name = _identifier(can_id) + ("x" if can_id & EXTENDED_FLAG else "")
        time, data = _seconds(t_us - self._start_us), _bytes_behind(" ", payload)
        return f"{time:0>14} 1  {name}             Rx   d {len(payload)}{data}\n"

    def close(self) -> None:
        """Write the end of the trigger block."""
        self._stream.write(b"End TriggerBlock\n")


class TrcWriter(_TextWriter):
    """Writes PCAN's trace format, version 2.1: milliseconds from the start, which is UTC in days since 1899.

    python-can's writer wants a file with a name, so that it could not write to standard output.
    """

    def _begin(self) -> str:
        days, rest_us = divmod(self._start_us, US_PER_DAY)
        fraction = round(rest_us * 10**14 / US_PER_DAY)  # of a day: finer than a microsecond
        lines = (
            ";$FILEVERSION=2.1",
            f";$STARTTIME={DAYS_TO_EPOCH + days}.{fraction:014d}",
            ";$COLUMNS=N,O,T,B,I,d,R,L,D",
            ";",
            ";   Message   Time    Type    ID     Rx/Tx",
            ";   Number    Offset  |  Bus  [hex]  |  Reserved",
            ";   |         [ms]    |  |    |      |  |  Data Length Code",
            ";   |         |       |  |    |      |  |  |    Data [hex] ...",
            ";---+-- ------+------ +- +- --+----- +- +- +--- +- -- -- -- -- -- -- --",
        )
        return "".join(f"{line}\r\n" for line in lines)

    def _line(self, t_us: int, can_id: int, payload: bytes) -> str:
        milliseconds, rest_us = divmod(t_us - self._start_us, US_PER_MS)
        begin = f"{self._count:>10} {milliseconds:>12}.{rest_us:03d} DT  1 {_identifier(can_id, 4)} Rx -  "
        return f"{begin}{len(payload)}   {_bytes_behind(' ', payload)}\r\n"


class CsvWriter(_TextWriter):
    """Writes what python-can's CSVWriter writes: seconds since the epoch, to the microsecond, payloads in base64."""

    def _begin(self) -> str:
        return "timestamp,arbitration_id,extended,remote,error,dlc,data\n"

    def _line(self, t_us: int, can_id: int, payload: bytes) -> str:
        kind = int(bool(can_id & EXTENDED_FLAG))
        data = b64encode(payload).decode()
        return f"{_seconds(t_us):0>17},0x{_identifier(can_id)},{kind},0,0,{len(payload)},{data}\n"


class GvretWriter(_TextWriter):
    """Writes what SavvyCAN saves as GVRET log: microseconds since the epoch, the bytes padded to eight columns."""

    def _begin(self) -> str:
        return "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"

    def _line(self, t_us: int, can_id: int, payload: bytes) -> str:
        kind = "true" if can_id & EXTENDED_FLAG else "false"
        data = _bytes_behind(",", payload.ljust(8, b"\0"))
        return f"{t_us:016d},{_identifier(can_id, 8)},{kind},Rx,0,{len(payload)}{data},\n"


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

    def __init__(self, stream: BinaryIO, header: LogHeader) -> None:
        self._stream = stream
        self._start_us = header.start_us // US_PER_MS * US_PER_MS
        self._stop_us = self._start_us
        self._waiting = np.empty(0, OBJECT)
        self._objects = 0
        self._inflated_bytes = FILE_HEADER.size
        self._write_header(FILE_HEADER.size)

    def write(self, t_us: Int64Array, frames: EncodedFrames) -> None:
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
    ExtraMissingError
        If asammdf is not installed.
    """

    def __init__(self, stream: BinaryIO, header: LogHeader) -> None:
        try:
            import asammdf  # noqa: PLC0415 - optional, and takes a second to import
            from asammdf.blocks import v4_constants  # noqa: PLC0415
            from asammdf.blocks.v4_blocks import SourceInformation  # noqa: PLC0415
        except ImportError as exc:
            raise LogFormatExtraError("MF4 needs asammdf: pip install '.[mf4]' in the checkout") from exc
        self._stream = stream
        self._start_us = header.start_us
        self._signal: Any = asammdf.Signal
        self._source: Any = SourceInformation(source_type=v4_constants.SOURCE_BUS, bus_type=v4_constants.BUS_TYPE_CAN)
        self._mdf: Any = asammdf.MDF(version=VERSION)
        self._mdf.header.start_time = datetime.fromtimestamp(self._start_us / US_PER_S, UTC)
        self._has_group = False

    def write(self, t_us: Int64Array, frames: EncodedFrames) -> None:
        samples = np.zeros(len(frames), FRAME)
        samples["CAN_DataFrame.BusChannel"] = BUS_CHANNEL
        samples["CAN_DataFrame.ID"] = frames.can_id & np.uint32(EXTENDED_FLAG - 1)
        samples["CAN_DataFrame.IDE"] = (frames.can_id & np.uint32(EXTENDED_FLAG)) != 0
        samples["CAN_DataFrame.DLC"] = frames.length
        samples["CAN_DataFrame.DataLength"] = frames.length
        samples["CAN_DataFrame.DataBytes"] = frames.data
        elapsed_s = (t_us - self._start_us) / US_PER_S
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
    ASC = "asc"
    MF4 = "mf4"
    TRC = "trc"
    CSV = "csv"
    GVRET = "gvret"


FORMAT_OF_SUFFIX: Final[Mapping[str, RecordFormat]] = MappingProxyType({
    ".log": RecordFormat.CANDUMP, ".blf": RecordFormat.BLF, ".asc": RecordFormat.ASC, ".mf4": RecordFormat.MF4,
    ".trc": RecordFormat.TRC, ".gvret.csv": RecordFormat.GVRET, ".csv": RecordFormat.CSV,
})  # fmt: skip
NOT_STREAMED: Final = frozenset({RecordFormat.BLF, RecordFormat.MF4})
STREAM_NAME: Final = "standard output"
_WRITERS: Final[Mapping[RecordFormat, type[FrameWriter]]] = MappingProxyType({
    RecordFormat.CANDUMP: CandumpWriter, RecordFormat.BLF: BlfWriter, RecordFormat.ASC: AscWriter,
    RecordFormat.MF4: Mf4Writer, RecordFormat.TRC: TrcWriter, RecordFormat.CSV: CsvWriter,
    RecordFormat.GVRET: GvretWriter,
})  # fmt: skip


class LogStream:
    """A log being written to a stream as it comes; formats that write their beginning last do not go to a pipe."""

    def __init__(self, stream: BinaryIO, log_format: RecordFormat, header: LogHeader, name: str = STREAM_NAME) -> None:
        self._stream = stream
        self._name = name
        self._header = header
        self._format = log_format
        self._writer = _WRITERS[log_format](stream, header)

    def write(self, frames: EncodedFrames) -> None:
        """Append frames, their times rounded to whole microseconds.

        Raises OSError if nobody takes them, RecordError if the format has no error frames.
        """
        if self._format is not RecordFormat.CANDUMP and np.any(frames.can_id & np.uint32(ERROR_FLAG)):
            raise RecordError(f"cannot write {self._name}: error frames are written to candump logs only")
        t_us = self._header.start_us + np.rint(frames.t_s * US_PER_S).astype(np.int64)
        self._writer.write(t_us, frames)
        self._stream.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if error is None:
            self._writer.close()
            self._stream.flush()


@contextmanager
def open_log(
    path: Path, *, log_format: RecordFormat | None = None, start_ns: int = DEFAULT_START_NS, channel: str = "vcan0"
) -> Iterator[LogStream]:
    """Write a log file while the block runs; if that ends with an exception, a file that was there before stays.

    Raises RecordError if the format is not known, asammdf is missing for MF4, the file cannot be created, or the disk
    is full or no longer takes data.

    Parameters
    ----------
    path : Path
        Where the file shall be; its suffix names the format unless ``log_format`` does.
    log_format : LogFormat
        The format, whatever the suffix says.
    start_ns : int
        Time since the epoch [ns] of scenario time 0; the same drive gives the same file.
    channel : str
        The interface's name, for the formats that keep it (candump).
    """
    if log_format is None and (log_format := format_of(path)) is None:
        known = ", ".join(f"{suffix} ({name})" for suffix, name in FORMAT_OF_SUFFIX.items())
        raise RecordError(f"{path}: no log format has the suffix {path.suffix!r}; there are {known}")
    if path.exists() and not path.is_file():
        raise RecordError(f"cannot write {path}: not a regular file")
    header = _header(start_ns, channel)
    with replacing(path, RecordError) as part:
        with part.open("wb") as stream:
            with LogStream(stream, log_format, header, str(path)) as log:
                yield log
            os.fsync(stream.fileno())
        part.replace(path)


def open_log_stream(
    stream: BinaryIO,
    *,
    log_format: RecordFormat | None = None,
    start_ns: int = DEFAULT_START_NS,
    channel: str = "vcan0",
) -> LogStream:
    """Begin a log on a stream, candump unless ``log_format`` names another; raises RecordError as ``open_log``."""
    log_format = log_format or RecordFormat.CANDUMP
    if log_format in NOT_STREAMED:
        raise RecordError(f"{log_format} is written to files only: its beginning is written last")
    return LogStream(stream, log_format, _header(start_ns, channel))


def _header(start_ns: int, channel: str) -> LogHeader:
    if not 0 <= start_ns <= LAST_START_NS:
        raise RecordError(f"start of the log out of range: {start_ns} ns since 1970")
    if not channel or any(character.isspace() for character in channel):
        raise RecordError(f"not a channel name: {channel!r}")
    return LogHeader(start_us=start_ns // NS_PER_US, channel=channel)


def format_of(path: Path) -> RecordFormat | None:
    """Return the format that the end of a file's name speaks of."""
    name = path.name.lower()
    return next((found for suffix, found in FORMAT_OF_SUFFIX.items() if name.endswith(suffix)), None)
