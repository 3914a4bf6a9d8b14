"""Zip and tar archives as folders of logs: ``drives.zip/monday.log`` is the path of what lies inside.

Nothing is written to the disk under a name that an archive gives, and no size that it states is trusted: the directory
of the archive and every member are read up to a limit.
"""

import io
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import BinaryIO, Final, Protocol, cast

from canlog.errors import ExtraMissingError, SourceError
from canlog.logs.detection import PROBE_BYTES, TEXT_LOGS, Detected, detect, detect_as_columns
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.streams import InflatedStream, check_growth, compression_of, kept

TAR_MAGIC, TAR_MAGIC_AT = b"ustar", 257
MOST_HEADER_BYTES: Final = 1024 * 1024  # of one header with its names and attributes, which are read at once
MOST_NAMED = 3  # members of an archive, in an error
COPY_BYTES = 1024 * 1024


def is_tar(probe: bytes) -> bool:
    """Return whether the first bytes of a file are those of a tar archive that is not compressed."""
    return probe[TAR_MAGIC_AT:].startswith(TAR_MAGIC)


def is_compressed_tar(stream: BinaryIO, probe: bytes) -> bool:
    """Return whether a file with these first bytes is a compressed tar archive; it is at its beginning again."""
    if compression_of(probe) is None:
        return False
    try:
        return is_tar(TarContents(stream, probe).read(tarfile.BLOCKSIZE))
    except (SourceError, ExtraMissingError):
        return False  # whoever reads it is told why
    finally:
        stream.seek(0)


class TarContents:
    """What is in a file, or in what is compressed there; going forward in it costs least."""

    def __init__(self, stream: BinaryIO, probe: bytes) -> None:
        compression = compression_of(probe)
        stream.seek(0)
        self._file = stream
        self._inflated = None if compression is None else InflatedStream(stream, compression)
        self._at = 0

    def tell(self) -> int:
        return self._at

    def seek(self, position: int) -> None:
        """Go to a position; behind the end there is nothing to be read."""
        if self._inflated is None:
            self._file.seek(position)
            self._at = position
            return
        if position < self._at:
            self._inflated = InflatedStream(self._file, self._inflated.kind)
            self._at = 0
        while self._at < position and self._next(min(SKIPPED_BYTES, position - self._at)):
            pass

    def read(self, size: int) -> bytes:
        """Return so many bytes, fewer at the end; raises SourceError if that is more than a header has."""
        if not 0 <= size <= MOST_HEADER_BYTES:
            raise SourceError(f"the tar archive has a header of {size} bytes: more than any name needs")
        pieces = list[bytes]()
        while size and (piece := self._next(size)):
            pieces.append(piece)
            size -= len(piece)
        return b"".join(pieces)

    def _next(self, most_bytes: int) -> bytes:
        piece = (self._inflated or self._file).read(most_bytes) or b""
        self._at += len(piece)
        return piece


class TarMember:
    """The contents of one file in a tar archive."""

    def __init__(self, contents: TarContents, info: tarfile.TarInfo) -> None:
        self._contents = contents
        self._at, self._end = info.offset_data, info.offset_data + info.size

    def read1(self, size: int) -> bytes:
        """Return up to so many bytes, none at the end; raises EOFError if the archive ends before."""
        wanted = min(size, self._end - self._at)
        self._contents.seek(self._at)
        piece = self._contents.read(wanted) if self._contents.tell() == self._at else b""
        self._at += len(piece)
        if wanted and not piece:
            raise EOFError
        return piece


def tar_infos(contents: TarContents) -> Iterator[tarfile.TarInfo]:
    """Yield what a tar archive holds besides folders, in its order.

    Raises SourceError if it is damaged, or ends before its last file does.
    """
    try:
        archive = tarfile.TarFile(fileobj=contents, mode="r")  # type: ignore[arg-type]  # a file as far as it is used
        last_at = -1
        while (info := archive.next()) is not None:
            if info.size < 0 or info.offset <= last_at:
                raise SourceError("the tar archive is damaged: a size is negative")
            last_at = info.offset
            archive.members.clear()  # type: ignore[attr-defined]  # else it keeps all, folders too
            if not info.isdir():
                yield info
        contents.seek(archive.offset)
        if contents.read(tarfile.BLOCKSIZE).strip(b"\0"):
            raise SourceError("the tar archive is damaged: what follows its last readable file is not a header")
    except (tarfile.TarError, ValueError, OverflowError, IndexError, EOFError, KeyError) as exc:
        raise SourceError(f"the tar archive is damaged: {exc}") from exc


def tar_refusal(info: tarfile.TarInfo) -> str:
    """Return why a file in a tar archive cannot be read; empty if it can."""
    if info.issym() or info.islnk():
        return "it is a link: unpack it first"
    if not info.isreg():
        return "it is a device or the like, not a file"
    return "it is a sparse file: unpack it first" if info.issparse() else ""


ZIP_MAGICS: Final = (b"PK\x03\x04", b"PK\x05\x06")  # a first member, or an archive of nothing
MOST_MEMBERS: Final = 1_000
MOST_DIRECTORY_BYTES: Final = 4 * 1024 * 1024  # of names and sizes, before any of them is looked at
END_RECORD: Final = struct.Struct("<4s4H2LH")
END_MAGIC: Final = b"PK\x05\x06"
LONGEST_COMMENT: Final = 65_535
LARGE_LOCATOR: Final = struct.Struct("<4sLQL")
LARGE_RECORD: Final = struct.Struct("<4sQ2H2L4Q")
LARGE_DIRECTORY_FIELD: Final = 8
LARGE: Final = 0xFFFF_FFFF
SKIPPED_BYTES: Final = 64 * 1024  # at a time, of a member that is passed over
PIECE_BYTES: Final = 16 * 1024  # what comes before damage is lost with the piece in which it is found
ENCRYPTED_FLAG, UTF_8_FLAG, UNIX = 0x1, 0x800, 3
UNICODE_PATH, EXTRA_HEADER = 0x7075, struct.Struct("<HH")  # its version and the checksum of the other name come first
KNOWN_METHODS: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


class MemberContents(Protocol):
    """What is in a member."""

    def read1(self, size: int, /) -> bytes:
        """Return up to so many bytes, none at the end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Member:
    """A file in an archive."""

    name: str
    packed_bytes: int
    refusal: str  # why it cannot be read; empty if it can
    kind: str  # of its archive: zip or tar
    open: Callable[[], MemberContents]  # the directory of the archive is read once for all


def is_archive(probe: bytes) -> bool:
    """Return whether the first bytes of a file are those of a zip archive, or of an uncompressed tar archive."""
    return probe.startswith(ZIP_MAGICS) or is_tar(probe)


def has_members(stream: BinaryIO) -> bool:
    """Return whether a file is an archive, a compressed one, too; it is at its beginning before and after."""
    probe = stream.read(PROBE_BYTES)
    stream.seek(0)
    return is_archive(probe) or is_compressed_tar(stream, probe)


def split_member(path: Path) -> tuple[Path, str]:
    """Return the file that a path leads to and, if that lies inside an archive, its name in there."""
    if path.exists():
        return path, ""
    archive = next((parent for parent in path.parents if parent.is_file()), None)
    return (path, "") if archive is None else (archive, path.relative_to(archive).as_posix())


def members_of(stream: BinaryIO) -> tuple[Member, ...]:
    """Return the files in an archive.

    Raises SourceError if it is damaged, encrypted as a whole, or has more of them than any collection of logs.
    """
    stream.seek(0)
    probe = stream.read(PROBE_BYTES)
    stream.seek(0)
    return _zip_members(stream) if probe.startswith(ZIP_MAGICS) else _tar_members(stream, probe)


def _zip_members(stream: BinaryIO) -> tuple[Member, ...]:
    try:
        _check_directory(stream)
        archive = zipfile.ZipFile(stream)  # closing it closes nothing: the file is ours
        infos = [info for info in archive.infolist() if not info.filename.endswith("/")]
    # NotImplementedError is zipfile's word for a version or method of packing that it does not know.
    except (zipfile.BadZipFile, NotImplementedError, ValueError, struct.error, EOFError, OverflowError) as exc:
        raise SourceError(f"the zip archive is damaged: {exc}") from exc
    if len(infos) > MOST_MEMBERS:
        raise SourceError(f"the zip archive holds {len(infos)} files; more than {MOST_MEMBERS} are not looked at")
    return tuple(
        Member(
            name=_plain(name),
            packed_bytes=info.compress_size,
            refusal=_zip_refusal(info) or _name_refusal(name),
            kind="zip",
            open=cast("Callable[[], MemberContents]", partial(archive.open, info)),
        )
        for info, name in ((info, _name_of(info)) for info in infos)
    )


def _tar_members(stream: BinaryIO, probe: bytes) -> tuple[Member, ...]:
    contents, found = TarContents(stream, probe), list[Member]()
    for info in tar_infos(contents):
        if len(found) == MOST_MEMBERS:
            raise SourceError(f"the tar archive holds more than {MOST_MEMBERS} files: these are not looked at")
        refusal = tar_refusal(info) or _name_refusal(info.name)
        opened = partial(TarMember, contents, info)
        found.append(Member(name=_plain(info.name), packed_bytes=info.size, refusal=refusal, kind="tar", open=opened))
    return tuple(found)


def _plain(name: str) -> str:
    """Return a name in an archive as the part of a path that it is."""
    return PurePosixPath(name.replace("\\", "/").lstrip("/")).as_posix()


def _name_of(info: zipfile.ZipInfo) -> str:
    """Return the name of a file: that of Info-ZIP's field for UTF-8, or as Unix writes it; else as ``zipfile`` does."""
    if info.flag_bits & UTF_8_FLAG:
        return info.filename
    raw, at = info.orig_filename.encode("cp437"), 0
    while at + EXTRA_HEADER.size <= len(info.extra):
        kind, size = EXTRA_HEADER.unpack_from(info.extra, at)
        body = info.extra[at + EXTRA_HEADER.size :][:size]
        at += EXTRA_HEADER.size + size
        if kind == UNICODE_PATH and body[:5] == struct.pack("<BL", 1, zlib.crc32(raw)):
            raw = body[5:]
            break
    else:
        raw = raw if info.create_system == UNIX else b"\xff"  # which is no UTF-8
    try:
        return raw.decode().partition("\0")[0]
    except UnicodeDecodeError:
        return info.filename


def _zip_refusal(info: zipfile.ZipInfo) -> str:
    if info.flag_bits & ENCRYPTED_FLAG:
        return "it is encrypted: unpack it first"
    if info.compress_type not in KNOWN_METHODS:
        return f"it is packed by method {info.compress_type}, not by deflate: unpack it first"
    return ""


def _name_refusal(name: str) -> str:
    if not name:
        return "it has no name: unpack it first"
    if ".." in PurePosixPath(_plain(name)).parts:
        return "its name leads out of the archive: unpack it first"
    return ""


def _check_directory(stream: BinaryIO) -> None:
    """Raise SourceError if the directory of an archive is too large to be read whole, as zipfile does."""
    size_bytes = stream.seek(0, io.SEEK_END)
    start = max(0, size_bytes - LONGEST_COMMENT - END_RECORD.size)
    stream.seek(start)
    tail = stream.read(size_bytes - start)
    at = tail.rfind(END_MAGIC)
    if at < 0 or at + END_RECORD.size > len(tail):
        raise SourceError("the zip archive is cut off: its directory is missing")
    directory_bytes = END_RECORD.unpack_from(tail, at)[5]
    if directory_bytes == LARGE and at >= LARGE_LOCATOR.size:
        stream.seek(min(LARGE_LOCATOR.unpack_from(tail, at - LARGE_LOCATOR.size)[2], size_bytes))
        record = stream.read(LARGE_RECORD.size)
        directory_bytes = LARGE_RECORD.unpack(record)[LARGE_DIRECTORY_FIELD] if len(record) == LARGE_RECORD.size else 0
    stream.seek(0)
    if directory_bytes > MOST_DIRECTORY_BYTES:
        raise SourceError(f"the zip archive lists {directory_bytes} bytes of names: more than any collection of logs")


class MemberStream(io.RawIOBase):
    """The contents of one member; what is damaged ends them and is counted, with what came before it.

    Without ``counts`` this is a look, which leaves the archive open.
    """

    def __init__(self, stream: BinaryIO, member: Member, counts: LogCounts | None = None) -> None:
        self._is_a_look = counts is None
        if member.refusal:
            raise SourceError(member.refusal)
        self._file = stream
        self._member = member
        self._counts = counts or LogCounts()
        at = stream.tell()  # what inflates a compressed archive goes on from here
        self._file_bytes = stream.seek(0, io.SEEK_END)
        stream.seek(at)
        self._given_bytes = 0
        try:
            self._contents: MemberContents | None = member.open()
        except (zipfile.BadZipFile, NotImplementedError, RuntimeError, ValueError, struct.error, EOFError) as exc:
            raise SourceError(f"{self.name} is damaged: {exc}") from exc

    @property
    def name(self) -> str:
        return f"{self._member.name} in the {self._member.kind} archive"

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: "memoryview | bytearray") -> int:  # type: ignore[override]  # any buffer will do
        """Fill the buffer as far as the next piece goes; 0 at the end."""
        view, contents = memoryview(buffer), self._contents
        try:
            piece = contents.read1(min(len(view), PIECE_BYTES)) if contents is not None else b""
        except EOFError:
            piece = self._end(LogReject.CUT_OFF)
        except (zipfile.BadZipFile, zlib.error):
            piece = self._end(LogReject.DAMAGED)
        view[: len(piece)] = piece
        self._given_bytes += len(piece)
        check_growth(self.name, min(self._member.packed_bytes, self._file_bytes), self._given_bytes)
        return len(piece)

    def close(self) -> None:
        if not self._is_a_look:
            self._file.close()
        super().close()

    def _end(self, reason: LogReject) -> bytes:
        self._contents = None
        self._counts.truncated = True
        self._counts.reject(reason, f"byte {self._given_bytes} of {self.name}")
        return b""


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

    Raises SourceError if there is no log, more than one, or one that is packed twice; the reason is in words.

    Parameters
    ----------
    stream
        The file, at its beginning.
    member
        What is meant of an archive; without it the archive has to hold one log only.
    columns
        What the columns of a text are; empty if its contents shall say.
    """
    probe = stream.read(PROBE_BYTES)
    stream.seek(0)
    if has_members(stream):
        return _unpacked(partial(MemberStream, stream, _meant(stream, member, columns)), columns)
    if member:
        raise SourceError("it is a file, not an archive")
    compression = compression_of(probe)
    if compression is None:
        detected = detect_as_columns(probe, columns) if columns else detect(probe)
        return Contents(stream=stream, detected=detected, counts=LogCounts(), is_packed=False, columns=columns)
    return _unpacked(partial(InflatedStream, stream, compression), columns)


def looks_inside(stream: BinaryIO, columns: str = "") -> Iterator[tuple[Member, Detected | SourceError]]:
    """Yield the files in an archive, each with what it is taken for or why it is no log; raises as ``members_of``."""
    for member in members_of(stream):
        try:
            yield member, _detected(MemberStream(stream, member), columns)
        except SourceError as exc:
            yield member, exc


def _meant(stream: BinaryIO, name: str, columns: str) -> Member:
    """Return the member that a name means; without one, the only one that is a log."""
    if name:
        found = [member for member in members_of(stream) if member.name == _plain(name)]
        if not found:
            raise SourceError(f"the archive holds no {name}")
        return found[-1]  # of two that are called alike the last one counts, as unpacking leaves it
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


def _unpacked(opened: Callable[..., PackedStream], columns: str) -> Contents:
    """Return the log that is packed in what is ``opened``: once for a look, and from its beginning to be read."""
    detected, counts = _detected(opened(), columns), LogCounts()
    packed = opened(counts)
    stream = cast("BinaryIO", packed)
    if detected.format not in TEXT_LOGS:
        with packed:
            stream = cast("BinaryIO", kept(iter(lambda: packed.read(COPY_BYTES), b"")))
    return Contents(stream=stream, detected=detected, counts=counts, is_packed=True, columns=columns)


def _detected(packed: PackedStream, columns: str) -> Detected:
    """Return what packed contents are taken for, by their beginning."""
    beginning = b""
    while len(beginning) < PROBE_BYTES and (piece := packed.read(PROBE_BYTES - len(beginning))):
        beginning += piece
    if not beginning:
        raise SourceError(f"{packed.name} holds nothing")
    inner = compression_of(beginning)
    if inner is not None or is_archive(beginning):
        inside = inner or ("tar" if is_tar(beginning) else "zip")
        raise SourceError(f"it is packed twice: {inside} inside {packed.name}; unpack it once")
    return detect_as_columns(beginning, columns) if columns else detect(beginning)
