"""Log files of four formats, told apart by their contents, as batches of frames."""

from collections.abc import Callable, Iterator, Mapping
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO

from diag_service.errors import SourceError
from diag_service.frames import FrameBatch
from diag_service.sources.asc import is_asc_header, read_asc
from diag_service.sources.blf import MAGIC as BLF_MAGIC
from diag_service.sources.blf import read_blf
from diag_service.sources.candump import holds_candump, read_candump
from diag_service.sources.mf4 import read_mf4
from diag_service.sources.tally import LogCounts, Tally

PROBE_BYTES = 64 * 1024
HEADER_LINES = 20  # an ASC file names itself in its first lines
MDF_MAGICS = (b"MDF     ", b"UnFinMF ")
MDF_VERSION = slice(8, 9)


class LogFormat(StrEnum):
    """The log formats that can be read."""

    CANDUMP = "candump"
    BLF = "blf"
    ASC = "asc"
    MF4 = "mf4"


READERS: Mapping[LogFormat, Callable[[BinaryIO, Tally], Iterator[FrameBatch]]] = MappingProxyType(
    {
        LogFormat.CANDUMP: read_candump,
        LogFormat.BLF: read_blf,
        LogFormat.ASC: read_asc,
        LogFormat.MF4: read_mf4,
    }
)


class LogReader(Iterator[FrameBatch]):
    """The frames of one log file, once, oldest first as far as the file is in order."""

    def __init__(self, path: Path, stream: BinaryIO, log_format: LogFormat) -> None:
        self.path = path
        self.format = log_format
        self._tally = Tally()
        self._stream = stream
        self._batches = READERS[log_format](stream, self._tally)

    @property
    def counts(self) -> LogCounts:
        """What has been found until now."""
        return self._tally.snapshot()

    def __next__(self) -> FrameBatch:
        """Return the next batch.

        Raises
        ------
        SourceError
            If the file cannot be read on, or its end is reached without a single frame.
        """
        try:
            return next(self._batches)
        except StopIteration:
            self.close()
            if self._tally.frames == 0:
                raise SourceError(
                    f"{self.path}: no CAN frame in this {self.format} log{self._first_reject()}"
                ) from None
            raise
        except OSError as exc:
            self.close()
            raise SourceError(f"{self.path}: {exc.strerror or exc}") from exc
        except SourceError as exc:
            self.close()
            raise SourceError(f"{self.path}: {exc}") from exc

    def close(self) -> None:
        """Close the file; reading to the end does it, too."""
        self._stream.close()

    def _first_reject(self) -> str:
        first = self.counts.first_rejected
        return f" ({first})" if first else ""


def read_log(path: Path | str) -> LogReader:
    """Open a log file and return its reader.

    Raises
    ------
    SourceError
        If the file is missing, unreadable, empty or not a log of a known format.
    """
    path = Path(path)
    try:
        stream = path.open("rb")
    except IsADirectoryError as exc:
        raise SourceError(f"{path}: is a folder, not a log file") from exc
    except FileNotFoundError as exc:
        raise SourceError(f"{path}: no such file") from exc
    except OSError as exc:
        raise SourceError(f"{path}: {exc.strerror or exc}") from exc
    try:
        log_format = detect_format(stream)
        stream.seek(0)
    except OSError as exc:
        stream.close()
        raise SourceError(f"{path}: {exc.strerror or exc}") from exc
    except SourceError as exc:
        stream.close()
        raise SourceError(f"{path}: {exc}") from exc
    return LogReader(path, stream, log_format)


def is_log(path: Path) -> bool:
    """Return whether a file is a log of a known format, by its first bytes; False if it cannot be read."""
    try:
        with path.open("rb") as stream:
            detect_format(stream)
    except (OSError, SourceError):
        return False
    return True


def detect_format(stream: BinaryIO) -> LogFormat:
    """Return the format that the first bytes of a file speak of, whatever its name.

    Raises
    ------
    SourceError
        If the file is empty or of no known format.
    """
    probe = stream.read(PROBE_BYTES)
    if not probe.strip():
        raise SourceError("the file is empty")
    if probe.startswith(BLF_MAGIC):
        return LogFormat.BLF
    if probe.startswith(MDF_MAGICS):
        if probe[MDF_VERSION] != b"4":
            raise SourceError("an MDF file of a version before 4: convert it")
        return LogFormat.MF4
    if any(is_asc_header(line.strip()) for line in probe.splitlines()[:HEADER_LINES]):
        return LogFormat.ASC
    if holds_candump(probe):
        return LogFormat.CANDUMP
    raise SourceError("not a candump, BLF, ASC or MF4 log")
