"""Which format the first bytes of a log speak of, whatever its name."""

from collections.abc import Callable, Mapping
from enum import StrEnum
from types import MappingProxyType

from diag_service.errors import SourceError
from diag_service.sources.readers import sqlite
from diag_service.sources.readers.asc import is_asc_header
from diag_service.sources.readers.blf import MAGIC as BLF_MAGIC
from diag_service.sources.readers.candump import holds_candump
from diag_service.sources.readers.tables import Busmaster, Crtd, GvretCsv, PythonCanCsv, Table, Trc, frames_in
from diag_service.sources.readers.tables.csv_tables import is_gvret_header, is_python_can_header

PROBE_BYTES = 64 * 1024
HEADER_LINES = 20  # a format that names itself does so in its first lines
MDF_MAGICS = (b"MDF     ", b"UnFinMF ")
MDF_VERSION = slice(8, 9)


class LogFormat(StrEnum):
    """The log formats that can be read."""

    CANDUMP = "candump"
    BLF = "blf"
    ASC = "asc"
    MF4 = "mf4"
    TRC = "trc"
    CSV = "csv"
    SQLITE = "sqlite"
    GVRET = "gvret"
    BUSMASTER = "busmaster"
    CRTD = "crtd"


TABLES: Mapping[LogFormat, Callable[[], Table]] = MappingProxyType(
    {
        LogFormat.TRC: Trc,
        LogFormat.CSV: PythonCanCsv,
        LogFormat.GVRET: GvretCsv,
        LogFormat.BUSMASTER: Busmaster,
        LogFormat.CRTD: Crtd,
    }
)
HEADERS: Mapping[LogFormat, Callable[[bytes], bool]] = MappingProxyType(
    {
        LogFormat.ASC: is_asc_header,
        LogFormat.TRC: lambda line: line.upper().startswith(b";$FILEVERSION"),
        LogFormat.CSV: is_python_can_header,
        LogFormat.GVRET: is_gvret_header,
        LogFormat.BUSMASTER: lambda line: line.startswith(b"***BUSMASTER"),
    }
)


def detect_format(probe: bytes) -> LogFormat:
    """Return the format of a file that begins so.

    Raises
    ------
    SourceError
        If the file is empty or of no known format.
    """
    if not probe.strip():
        raise SourceError("the file is empty")
    if probe.startswith(BLF_MAGIC):
        return LogFormat.BLF
    if probe.startswith(sqlite.MAGIC):
        return LogFormat.SQLITE
    if probe.startswith(MDF_MAGICS):
        if probe[MDF_VERSION] != b"4":
            raise SourceError("an MDF file of a version before 4: convert it")
        return LogFormat.MF4
    return detect_text(probe)


def detect_text(probe: bytes) -> LogFormat:
    """Return the format of a text: the one that a first line names, else the one that most lines are in.

    Raises
    ------
    SourceError
        If it is of no known format.
    """
    first_lines = [line.strip() for line in probe.splitlines()[:HEADER_LINES]]
    for log_format, is_header in HEADERS.items():
        if any(is_header(line) for line in first_lines):
            return log_format
    if holds_candump(probe):
        return LogFormat.CANDUMP
    found = {log_format: frames_in(new_table(), probe) for log_format, new_table in TABLES.items()}
    likeliest = max(found, key=lambda log_format: found[log_format])
    if not found[likeliest]:
        raise SourceError(f"not a log of a known format ({', '.join(LogFormat)})")
    return likeliest
