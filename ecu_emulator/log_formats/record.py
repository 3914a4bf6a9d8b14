"""Frames into log files, faster than real time: candump, BLF, ASC, MF4, TRC or CSV, whole or not at all."""

import os
from collections.abc import Mapping
from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO, Final, Self

import numpy as np

from canlog.frames import ERROR_FLAG
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.errors import RecordError
from ecu_emulator.log_formats import writers

DEFAULT_START_NS: Final = 1_767_225_600_000_000_000  # 2026-01-01T00:00:00Z
US_PER_S: Final = 1e6
NS_PER_US: Final = 1_000
LAST_START_NS: Final = 9_000_000_000_000_000_000  # the year 2255; ten digits of seconds, 64 bits of nanoseconds


class LogFormat(StrEnum):
    """The log formats that can be written."""

    CANDUMP = "candump"
    BLF = "blf"
    ASC = "asc"
    MF4 = "mf4"
    TRC = "trc"
    CSV = "csv"
    GVRET = "gvret"


FORMAT_OF_SUFFIX: Final[Mapping[str, LogFormat]] = MappingProxyType({
    ".log": LogFormat.CANDUMP, ".blf": LogFormat.BLF, ".asc": LogFormat.ASC, ".mf4": LogFormat.MF4,
    ".trc": LogFormat.TRC, ".gvret.csv": LogFormat.GVRET, ".csv": LogFormat.CSV,
})  # fmt: skip
NOT_STREAMED: Final = frozenset({LogFormat.BLF, LogFormat.MF4})
STREAM_NAME: Final = "standard output"
_WRITERS: Final[Mapping[LogFormat, type[writers.FrameWriter]]] = MappingProxyType({
    LogFormat.CANDUMP: writers.CandumpWriter, LogFormat.BLF: writers.BlfWriter, LogFormat.ASC: writers.AscWriter,
    LogFormat.MF4: writers.Mf4Writer, LogFormat.TRC: writers.TrcWriter, LogFormat.CSV: writers.CsvWriter,
    LogFormat.GVRET: writers.GvretWriter,
})  # fmt: skip


class LogStream:
    """A log being written to a stream as it comes; formats that write their beginning last do not go there."""

    def __init__(
        self, stream: BinaryIO, log_format: LogFormat, header: writers.Header, name: str = STREAM_NAME
    ) -> None:
        self._stream = stream
        self._name = name
        self._header = header
        self._format = log_format
        self._writer = _WRITERS[log_format](stream, header)

    def write(self, frames: EncodedFrames) -> None:
        """Append frames; raises OSError if nobody takes them, RecordError as ``LogFile.write``."""
        if self._format is not LogFormat.CANDUMP and np.any(frames.can_id & np.uint32(ERROR_FLAG)):
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


class LogFile(LogStream):
    """A log being written under a temporary name; the end of the ``with`` block gives it its own.

    If the block ends with an exception, nothing is left behind, and a file that was there before stays as it was.
    """

    def __init__(self, path: Path, log_format: LogFormat, header: writers.Header) -> None:
        self._path = path
        self._temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            stream = self._temporary.open("wb")
        except OSError as exc:
            raise self._failed(exc) from exc
        try:
            super().__init__(stream, log_format, header, str(path))
        except OSError as exc:
            self._discard()
            raise self._failed(exc) from exc
        except RecordError:
            self._discard()
            raise

    def write(self, frames: EncodedFrames) -> None:
        """Append frames; their times are rounded to whole microseconds.

        Raises RecordError if the disk is full or no longer takes data, or the format has no error frames.
        """
        try:
            super().write(frames)
        except OSError as exc:
            raise self._failed(exc) from exc

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if error is not None:
            self._discard()
            return
        try:
            self._writer.close()
            self._stream.flush()
            os.fsync(self._stream.fileno())
            self._stream.close()
            self._temporary.replace(self._path)
        except OSError as exc:
            self._discard()
            raise self._failed(exc) from exc

    def _discard(self) -> None:
        with suppress(OSError):
            self._stream.close()
        with suppress(OSError):
            self._temporary.unlink(missing_ok=True)

    def _failed(self, error: OSError) -> RecordError:
        return RecordError(f"cannot write {self._path}: {error.strerror or error}")


def open_log(
    path: Path, *, log_format: LogFormat | None = None, start_ns: int = DEFAULT_START_NS, channel: str = "vcan0"
) -> LogFile:
    """Begin a log file.

    Raises RecordError if the format is not known, asammdf is missing for MF4, or the file cannot be created.

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
    return LogFile(path, log_format, _header(start_ns, channel))


def open_log_stream(
    stream: BinaryIO,
    *,
    log_format: LogFormat | None = None,
    start_ns: int = DEFAULT_START_NS,
    channel: str = "vcan0",
) -> LogStream:
    """Begin a log on a stream, candump unless ``log_format`` names another; raises RecordError as ``open_log``."""
    log_format = log_format or LogFormat.CANDUMP
    if log_format in NOT_STREAMED:
        raise RecordError(f"{log_format} is written to files only: its beginning is written last")
    return LogStream(stream, log_format, _header(start_ns, channel))


def _header(start_ns: int, channel: str) -> writers.Header:
    if not 0 <= start_ns <= LAST_START_NS:
        raise RecordError(f"start of the log out of range: {start_ns} ns since 1970")
    if not channel or any(character.isspace() for character in channel):
        raise RecordError(f"not a channel name: {channel!r}")
    return writers.Header(start_us=start_ns // NS_PER_US, channel=channel)


def format_of(path: Path) -> LogFormat | None:
    """Return the format that the end of a file's name speaks of."""
    name = path.name.lower()
    return next((found for suffix, found in FORMAT_OF_SUFFIX.items() if name.endswith(suffix)), None)
