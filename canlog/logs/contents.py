"""What a log file holds: the log itself, or one that is compressed as a whole."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import BinaryIO, Final, cast

from canlog.errors import SourceError
from canlog.logs.detection import PROBE_BYTES, TEXT_LOGS, Detected, detect, detect_as_columns
from canlog.logs.log_counts import LogCounts
from canlog.logs.streams import InflatedStream, compression_of, kept

COPY_BYTES: Final = 1024 * 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class Contents:
    """A log to be read."""

    stream: BinaryIO
    detected: Detected
    counts: LogCounts
    is_packed: bool  # the size of the file says nothing about that of its contents
    columns: str = ""  # what somebody says of them


def contents_of(stream: BinaryIO, columns: str = "") -> Contents:
    """Return the log that an open file is or holds; raises SourceError with the reason if there is none.

    Parameters
    ----------
    stream
        The file, at its beginning.
    columns
        What the columns of a text are; empty if its contents shall say.
    """
    probe = stream.read(PROBE_BYTES)
    stream.seek(0)
    compression = compression_of(probe)
    if compression is None:
        detected = detect_as_columns(probe, columns) if columns else detect(probe)
        return Contents(stream=stream, detected=detected, counts=LogCounts(), is_packed=False, columns=columns)
    return _unpacked(partial(InflatedStream, stream, compression), columns)


def _unpacked(opened: Callable[..., InflatedStream], columns: str) -> Contents:
    """Return the log that is packed in what is ``opened``: once for a look, and from its beginning to be read."""
    detected, counts = _detected(opened(), columns), LogCounts()
    packed = opened(counts)
    stream = cast("BinaryIO", packed)
    if detected.format not in TEXT_LOGS:
        with packed:
            stream = cast("BinaryIO", kept(iter(lambda: packed.read(COPY_BYTES), b"")))
    return Contents(stream=stream, detected=detected, counts=counts, is_packed=True, columns=columns)


def _detected(packed: InflatedStream, columns: str) -> Detected:
    """Return what packed contents are taken for, by their beginning."""
    beginning = b""
    while len(beginning) < PROBE_BYTES and (piece := packed.read(PROBE_BYTES - len(beginning))):
        beginning += piece
    if not beginning:
        raise SourceError(f"{packed.name} holds nothing")
    if inner := compression_of(beginning):
        raise SourceError(f"it is packed twice: {inner} inside {packed.name}; unpack it once")
    return detect_as_columns(beginning, columns) if columns else detect(beginning)
