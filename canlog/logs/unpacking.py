"""What a file holds once it is unpacked: a stream and the format of its contents.

Texts are read as they are unpacked. Formats that must be sought in are unpacked into a temporary file first.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO, cast

from canlog.errors import SourceError
from canlog.logs.archives import Member, MemberStream, find_member, has_members, is_archive, is_tar, members_of
from canlog.logs.compressed import InflatedStream, compression_of
from canlog.logs.detection import PROBE_BYTES, TEXT_LOGS, Detected, detect, detect_as_columns
from canlog.logs.log_counts import LogCounts
from canlog.logs.piped import KeptFile

MOST_NAMED = 3  # members of an archive, in an error
COPY_BYTES = 1024 * 1024
PackedStream = InflatedStream | MemberStream


@dataclass(frozen=True, slots=True, kw_only=True)
class Contents:
    """A log to be read."""

    stream: BinaryIO
    detected: Detected
    counts: LogCounts
    is_packed: bool  # the size of the file says nothing about that of its contents
    columns: str = ""  # what somebody says of them


def contents_of(stream: BinaryIO, member: str = "", columns: str = "") -> Contents:
    """Return the log that an open file is or holds.

    Parameters
    ----------
    stream
        The file, at its beginning.
    member
        What is meant of an archive; without it the archive has to hold one log only.
    columns
        What the columns of a text are; empty if its contents shall say.

    Raises
    ------
    SourceError
        If there is no log, more than one, or one that is packed twice; the reason is in words.
    """
    probe = stream.read(PROBE_BYTES)
    stream.seek(0)
    if has_members(stream):
        return _unpacked(MemberStream(stream, _meant(stream, member, columns)), columns)
    if member:
        raise SourceError("it is a file, not an archive")
    compression = compression_of(probe)
    if compression is None:
        detected = detect_as_columns(probe, columns) if columns else detect(probe)
        return Contents(stream=stream, detected=detected, counts=LogCounts(), is_packed=False, columns=columns)
    return _unpacked(InflatedStream(stream, compression), columns)


def looks_inside(stream: BinaryIO, columns: str = "") -> Iterator[tuple[Member, Detected | SourceError]]:
    """Yield the files in an archive, each with what it is taken for or why it is no log; raises as ``members_of``."""
    for member in members_of(stream):
        try:
            yield member, _detected(MemberStream(stream, member, is_a_look=True), columns)
        except SourceError as exc:
            yield member, exc


def _meant(stream: BinaryIO, name: str, columns: str) -> Member:
    """Return the member that a name means; without one, the only one that is a log."""
    if name:
        return find_member(members_of(stream), name)
    looks = list(looks_inside(stream, columns))
    logs = [member for member, found in looks if isinstance(found, Detected)]
    if len(logs) == 1:
        return logs[0]
    if logs:
        named = ", ".join(member.name for member in logs[:MOST_NAMED])
        raise SourceError(
            f"the {logs[0].kind} archive holds {len(logs)} logs ({named}{', ...' if len(logs) > MOST_NAMED else ''}): "
            f"name one, behind the archive and a slash"
        )
    first = next((f": {member.name}: {reason}" for member, reason in looks), "")
    raise SourceError(f"the {looks[0][0].kind if looks else 'empty'} archive holds no log{first}")


def _unpacked(packed: PackedStream, columns: str) -> Contents:
    detected, counts = _detected(packed, columns), LogCounts()
    packed.restart(counts)
    stream = cast("BinaryIO", packed)
    if detected.format not in TEXT_LOGS:
        with packed:
            stream = _kept(packed)
    return Contents(stream=stream, detected=detected, counts=counts, is_packed=True, columns=columns)


def _detected(packed: PackedStream, columns: str) -> Detected:
    """Return what packed contents are taken for, by their beginning."""
    beginning = _beginning(packed)
    inner = compression_of(beginning)
    if inner is not None or is_archive(beginning):
        inside = inner or ("tar" if is_tar(beginning) else "zip")
        raise SourceError(f"it is packed twice: {inside} inside {packed.name}; unpack it once")
    return detect_as_columns(beginning, columns) if columns else detect(beginning)


def _beginning(packed: PackedStream) -> bytes:
    """Return the first bytes that something packed holds."""
    pieces, missing_bytes = list[bytes](), PROBE_BYTES
    while missing_bytes and (piece := packed.read(missing_bytes)):
        pieces.append(piece)
        missing_bytes -= len(piece)
    if not pieces:
        raise SourceError(f"{packed.name} holds nothing")
    return b"".join(pieces)


def _kept(packed: PackedStream) -> BinaryIO:
    """Return a temporary file with all that something packed holds; raises OSError if the disk does not take it."""
    folder = TemporaryDirectory(prefix="clutchdiag-")
    try:
        path = Path(folder.name) / "log"
        with path.open("wb") as file:
            while piece := packed.read(COPY_BYTES):
                file.write(piece)
        return cast("BinaryIO", KeptFile(folder, path))
    except BaseException:
        folder.cleanup()
        raise
