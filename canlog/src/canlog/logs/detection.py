"""The format of a log, by its first bytes; its name does not matter."""

import codecs
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial

from canlog.database.signal_columns import SignalColumn
from canlog.errors import SourceError
from canlog.logs.asc import FIRST_LINE, AscLog, is_asc_header
from canlog.logs.blf import MAGIC as BLF_MAGIC
from canlog.logs.candump import CandumpLog, ConsoleLog
from canlog.logs.captures import CAPTURE_MAGICS, capture_of
from canlog.logs.columns import NO_HEADER, ColumnsLog, header_names, is_list, programs
from canlog.logs.columns.log import TableLog
from canlog.logs.columns.programs import CLX000_HEADER, Busmaster, Clx000, Trc
from canlog.logs.log_counts import LogCounts
from canlog.logs.signal_tables import LEAST_ROWS, NoTable, table_of
from canlog.logs.text_log import BYTE_ORDER_MARK, TextLog, frames_of

PROBE_BYTES = 64 * 1024
HEADER_LINES = 20  # looked at for a header
LINES_LOOKED_AT = 100  # without a header; most of them must be frames of the format
COMMENTS = (b"#", b"//")
UTF_16_BYTES = 64
LEAST_OF_TEXT = 9  # the code of a tab, the least of a text
MDF_MAGICS = (b"MDF     ", b"UnFinMF ")
MDF_VERSION = slice(8, 9)


class LogFormat(StrEnum):
    """The log formats that can be read."""

    CANDUMP = "candump"
    CONSOLE = "candump-console"
    BLF = "blf"
    ASC = "asc"
    MF4 = "mf4"
    TRC = "trc"
    CSV = "csv"
    GVRET = "gvret"
    BUSMASTER = "busmaster"
    CRTD = "crtd"
    CLX000 = "clx000"
    PCAP = "pcap"
    PCAPNG = "pcapng"
    COLUMNS = "columns"
    SIGNALS = "signals"

    @property
    def content(self) -> str:
        """What such a log holds, for people: a table of signals has no frames."""
        return "values" if self is LogFormat.SIGNALS else "frames"


# In this order a text without a header is tried.
TEXT_LOGS: Mapping[LogFormat, Callable[[], TextLog]] = {
    LogFormat.CANDUMP: CandumpLog,
    LogFormat.CONSOLE: ConsoleLog,
    LogFormat.TRC: Trc,
    LogFormat.CSV: programs.PythonCanCsv,
    LogFormat.GVRET: programs.GvretCsv,
    LogFormat.BUSMASTER: Busmaster,
    LogFormat.CRTD: partial(TableLog, programs.CRTD),
    LogFormat.CLX000: Clx000,
    LogFormat.ASC: AscLog,
    LogFormat.COLUMNS: ColumnsLog,  # by the names in its header, never by its lines
}
NAMED_ONLY = frozenset({LogFormat.COLUMNS, LogFormat.CLX000})  # columns of any name, and times of any digits
UNNAMED = tuple(log_format for log_format in TEXT_LOGS if log_format not in NAMED_ONLY)
HEADERS: Mapping[LogFormat, re.Pattern[bytes]] = {
    LogFormat.ASC: FIRST_LINE,
    LogFormat.TRC: re.compile(rb";\$FILEVERSION", re.IGNORECASE),
    LogFormat.CSV: programs.PYTHON_CAN_HEADER,
    LogFormat.GVRET: programs.GVRET_HEADER,
    LogFormat.BUSMASTER: re.compile(rb"\*\*\*BUSMASTER"),
    LogFormat.CLX000: CLX000_HEADER,
}


# What lines without a header must look like besides being frames: their grammars accept too much.
TYPICAL: Mapping[LogFormat, re.Pattern[bytes]] = {
    LogFormat.CONSOLE: re.compile(
        rb"(?:\x1b\[[\d;]*m|\s)*(?:\([-\d.: ]+\)\s+)?(?:\x1b\[[\d;]*m)*\s*"  # colours, a time
        rb"[\w.-]+[^\n\[{]{0,40}[0-9A-F]{1,8}\s+[\[{]|DROPCOUNT:"
    ),
    LogFormat.TRC: re.compile(rb"\s*(?:\d+\)\s+-?[\d.]+\s|;)"),
    LogFormat.CSV: re.compile(rb"[\d.eE+-]+,\s*0x[0-9a-fA-F]+,[01],"),
    LogFormat.GVRET: re.compile(rb"[\d.eE+-]+,[0-9a-fA-F]+,(?:true|false),", re.IGNORECASE),
    LogFormat.BUSMASTER: re.compile(rb"\s*(?:\d+:\d+:\d+:\d+\s+[RT]x\s|\*\*\*)"),
    LogFormat.CRTD: re.compile(rb"\d+(?:\.\d+)?\s+\d?(?:[RT](?:11|29)|C[A-Z]{2})\s"),
}
ONLY_LISTED = "a list of identifiers, not a log: no times rise, and no identifier comes again with bytes"
MOST_NAMED = 20  # columns in a complaint
TAR_MAGIC, TAR_MAGIC_AT = b"ustar", 257
SQLITE_MAGIC = b"SQLite format 3\0"
ARCHIVES: Mapping[bytes, str] = {
    b"PK\x03\x04": "zip",
    b"PK\x05\x06": "zip",
    b"7z\xbc\xaf": "7z",
    b"Rar!\x1a\x07": "RAR",
}
OTHER_FORMATS: Mapping[bytes, str] = {
    b"\x04\x22\x4d\x18": "a file compressed by lz4",
    b"\x1f\x9d": "a file compressed by compress",
    b"PAR1": "a Parquet table: convert it to CSV, for example by pandas",
    b"ARROW1": "an Arrow table: convert it to CSV, for example by pandas",
    b'VERSION "': "a message database (DBC): it belongs behind --dbc",
    b"FormatVersion=": "a message database (SYM): it belongs behind --dbc",
    b"<?xml": "an XML text",
}
PAGES: tuple[bytes, ...] = (b"<!doctype html", b"<html")  # in lower case
TEXTS: Mapping[str, re.Pattern[bytes]] = {
    "an XML or HTML text": re.compile(rb"\s*<[A-Za-z!][^<]*>"),
    "a JSON text": re.compile(rb"""\s*(?:\{\s*"[^"\n]*"\s*:|\[\s*[\[{])"""),
    "a message database (DBC): it belongs behind --dbc": re.compile(rb"(?:.*\n){0,60}BO_ \d+ \w+ *:"),
}
"""What begins so, as far as nothing else is known of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Detected:
    """What a file was taken for, and why."""

    format: LogFormat
    evidence: str
    columns: tuple[SignalColumn, ...] = ()  # of a table of signals
    is_long: bool = False  # a table with a row for each value, whose beginning need not name all signals


def detect(probe: bytes, choice: str = "") -> Detected:
    """Return the format of a file that begins so; raises SourceError if the file is empty or of no known format.

    Parameters
    ----------
    probe
        The beginning.
    choice
        What its columns are, as ``--columns`` has it. If that fits, the file is a table, else it is detected without;
        if that fails as well, the error is about the columns.
    """
    return _detect_as_columns(probe, choice) if choice else _detect(probe)


def _detect(probe: bytes) -> Detected:
    if not probe.strip():
        raise SourceError("the file is empty")
    _refuse_container(probe)
    if probe.startswith(BLF_MAGIC):
        return Detected(format=LogFormat.BLF, evidence="it begins with LOGG")
    if probe.startswith(CAPTURE_MAGICS):
        capture = capture_of(probe)
        return Detected(format=LogFormat(capture), evidence=f"it begins with the number of {capture}")
    if probe.startswith(MDF_MAGICS):
        if probe[MDF_VERSION] != b"4":
            raise SourceError("an MDF file of a version before 4: convert it")
        return Detected(format=LogFormat.MF4, evidence=f"it begins with {probe[: MDF_VERSION.stop].decode('ascii')}")
    return detect_text(probe)


def _refuse_container(probe: bytes) -> None:
    kind = "tar" if probe[TAR_MAGIC_AT:].startswith(TAR_MAGIC) else ""
    if kind := kind or next((kind for magic, kind in ARCHIVES.items() if probe.startswith(magic)), ""):
        raise SourceError(f"a {kind} archive: unpack it first")
    if probe.startswith(SQLITE_MAGIC):
        raise SourceError("an SQLite database: if it is a log of python-can, can_logconvert makes a BLF of it")


def _detect_as_columns(probe: bytes, choice: str) -> Detected:
    _refuse_container(probe)
    text, complaint = probe.removeprefix(BYTE_ORDER_MARK), SourceError("--columns: no line of it is a frame by that")
    try:
        log = ColumnsLog(choice)
        log.look_ahead(text)
        if _has_frames(log, text):
            return Detected(format=LogFormat.COLUMNS, evidence=f"its columns are {log.columns_text}")
    except SourceError as exc:
        complaint = exc
    try:
        return _detect(probe)
    except SourceError as exc:
        raise (exc if str(complaint) == NO_HEADER else complaint) from None


def detect_text(probe: bytes) -> Detected:
    """Return the format of a text: the one that a first line names, else the one that most of its first lines are in.

    Raises SourceError if it is of no known format.
    """
    text = probe.removeprefix(BYTE_ORDER_MARK)
    for number, line in enumerate(text.splitlines()[:HEADER_LINES], 1):
        for log_format, first in HEADERS.items():
            if first.match(line.strip()) and (log_format is not LogFormat.ASC or is_asc_header(line.strip())):
                return Detected(format=log_format, evidence=f"line {number} is its header")
    lines = first_lines(text, is_cut=len(probe) >= PROBE_BYTES)
    hint, most = "", 0
    for log_format in UNNAMED:
        frames, others = _counted(log_format, lines)
        shown = f"{frames} of the first {len(lines)} lines"
        if frames > others:
            return Detected(format=log_format, evidence=f"{shown} are frames in its grammar")
        if frames > most:
            hint, most = f"{shown} fit {log_format}", frames
    if named := _by_named_columns(text):
        return named
    table = table_of(probe)
    if isinstance(table, NoTable):
        raise SourceError(_not_known(probe, hint, table))
    is_long = table.name_place is not None
    rows = "one value each" if is_long else f"{len(table.columns)} signals"
    evidence = f"line {table.lines} is followed by rows of {rows}: {'; '.join(table.reasons)}"
    return Detected(format=LogFormat.SIGNALS, evidence=evidence, columns=table.columns, is_long=is_long)


def _by_named_columns(text: bytes) -> Detected | None:
    """Return that a text is a table, if a header names its columns and most lines behind it are frames.

    Raises SourceError if it lists identifiers and notes on them.
    """
    log = ColumnsLog()
    try:
        log.look_ahead(text)
    except SourceError:
        return None
    if not _has_frames(log, text):
        return None
    if is_list(frames_of(log, text), log.layout.columns):
        raise SourceError(f"{ONLY_LISTED}; if it is one, say --columns {shlex.quote(log.columns_text)}")
    number = log.layout.header_lines
    what = f"line {number} names its columns" if number else "its lines are those of HCRL's car hacking data set"
    return Detected(format=LogFormat.COLUMNS, evidence=f"{what}: {log.columns_text}")


def _has_frames(log: ColumnsLog, text: bytes) -> bool:
    """Return whether most of the first lines behind a header are frames."""
    counts, lines = LogCounts(), text.splitlines()[: log.layout.header_lines + LINES_LOOKED_AT]
    return len(frames_of(log, b"\n".join(lines), counts)) > sum(counts.rejected.values())


def first_lines(text: bytes, *, is_cut: bool) -> list[bytes]:
    """Return the first lines that are neither empty nor comments of any program; the last may be cut off."""
    lines = text.splitlines()
    if is_cut and len(lines) > 1:
        del lines[-1]
    return [line for line in lines if line.strip() and not line.lstrip().startswith(COMMENTS)][:LINES_LOOKED_AT]


def utf_16_of(probe: bytes) -> str:
    """Return the encoding of a text that has two bytes for each character; empty for any other."""
    for encoding, mark in (("utf-16-le", codecs.BOM_UTF16_LE), ("utf-16-be", codecs.BOM_UTF16_BE)):
        beginning = probe[:UTF_16_BYTES].removeprefix(mark)
        low, high = (beginning[::2], beginning[1::2]) if encoding == "utf-16-le" else (beginning[1::2], beginning[::2])
        if probe.startswith(mark) and probe[len(mark) : 2 * len(mark)] != b"\0\0":
            return encoding
        if high and not any(high) and min(low, default=0) >= LEAST_OF_TEXT:
            return encoding
    return ""


def has_returns_alone(probe: bytes) -> bool:
    """Return whether the lines of a text end as on an old Macintosh: with a carriage return and no newline."""
    return (
        probe.count(b"\r") >= LEAST_ROWS and b"\n" not in probe and b"\0" not in probe and min(probe) >= LEAST_OF_TEXT
    )


def _counted(log_format: LogFormat, lines: Sequence[bytes]) -> tuple[int, int]:
    """Return how many lines are frames of a format, and how many neither that nor something else of it."""
    typical = TYPICAL.get(log_format)
    counts, fitting = LogCounts(), [line for line in lines if typical is None or typical.match(line)]
    frames = len(frames_of(TEXT_LOGS[log_format](), b"\n".join(fitting), counts)) if fitting else 0
    frames = min(frames, len(fitting))  # one line may hold several
    skipped = 0 if log_format is LogFormat.ASC else counts.skipped  # ASC skips whatever begins with a time
    return frames, len(lines) - frames - skipped


def _not_known(probe: bytes, hint: str, no_table: NoTable) -> str:
    """Return why a text is no log."""
    other = next((name for magic, name in OTHER_FORMATS.items() if probe.startswith(magic)), "")
    if probe.lstrip().lower().startswith(PAGES):  # whose styles look like columns
        other = "an HTML page"
    other = other or next((name for name, beginning in TEXTS.items() if beginning.match(probe)), "")
    known = f"not a log of a known format ({', '.join(LogFormat)})"
    advice = "" if other or no_table.is_list else _as_table(probe)
    if not other and (no_table.why or advice):
        return f"{known}: {'; '.join(filter(None, (no_table.why, advice)))}"
    return f"{known}: {other or f'only {hint}'}" if other or hint else known


def _as_table(probe: bytes) -> str:
    """Return what one may do about what looks like a table; nothing if it does not."""
    header = header_names(probe)
    if not header:
        return ""
    more = f" and {len(header) - MOST_NAMED} more" if len(header) > MOST_NAMED else ""
    names = ", ".join(header[:MOST_NAMED]) + more
    return (
        f"a table with the columns {names}; --columns time=...,id=...,data=... says which are which; a table of "
        "signals has a column of times that rise (numbers, hh:mm:ss, ISO dates) and one of numbers, "
        f"in {LEAST_ROWS} rows and more"
    )
